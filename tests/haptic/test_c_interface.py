"""The frame called from C agrees with `render_into` bit for bit, updates included."""

import ctypes
import re
import shutil
import time
from pathlib import Path

import numba
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import (
    DRAG,
    TWIST,
    TtusError,
    built_c,
    deepest_pose,
    pressing,
    python,
    scaled,
    small_scene,
)
from ttus_opt.haptic import c_interface
from ttus_opt.haptic.c_interface import DONE, HEADER, WAITING, frame_address
from ttus_opt.haptic.renderer import LIMITS, Renderer

pytestmark = pytest.mark.skipif(
    numba.config.DISABLE_JIT, reason="without the compiler there is no C function"
)

REAL = ctypes.POINTER(ctypes.c_double)


class Loop(ctypes.Structure):
    """``loop`` of c_loop.c."""

    _fields_ = [
        ("frame", ctypes.c_void_p),
        ("context", ctypes.c_void_p),
        ("n", ctypes.c_int64),
        *((name, REAL) for name in ("rotation", "position", "twist", "time", "wrench")),
        ("count", ctypes.POINTER(ctypes.c_int32)),
        ("rounds", ctypes.c_int64),
        ("stop", ctypes.c_int64),
        ("frames", ctypes.c_int64),
        ("thread", ctypes.c_uint64),
    ]


@pytest.fixture(scope="module")
def library(tmp_path_factory):
    source, flags = Path(__file__).with_name("c_loop.c"), "-std=c11 -Wall -O1 -pthread"
    return built_c(source, tmp_path_factory, *flags.split(), f"-I{HEADER.parent}")


class CLoop:
    """Poses to render in a thread of C's, and what it found."""

    def __init__(self, library, renderer, poses, rounds=1):
        self.library, given = library, renderer.c_function()
        rotation, position, twist, times = (
            np.ascontiguousarray(a, dtype=float) for a in poses
        )
        n = len(rotation)
        self.wrench, self.count = np.zeros((n, 6)), np.zeros(n, dtype=np.int32)
        self.arrays = rotation, position, twist, times, self.wrench
        self.loop = Loop(
            given.function,
            given.context,
            n,
            *(a.ctypes.data_as(REAL) for a in self.arrays),
            self.count.ctypes.data_as(ctypes.POINTER(ctypes.c_int32)),
            rounds,
        )

    def start(self):
        assert self.library.loop_start(ctypes.byref(self.loop)) == 0

    def join(self):
        self.loop.stop = 1
        assert self.library.loop_join(ctypes.byref(self.loop)) == 0

    def run(self):
        self.start()
        assert self.library.loop_join(ctypes.byref(self.loop)) == 0


def poses_of(scene, n=40):
    """In and out of contact, moving and turning, one of them off the grid."""
    rng = np.random.default_rng(2)
    R, at = deepest_pose(scene)
    turns = Rotation.from_rotvec(0.1 * rng.normal(size=(n, 3))).as_matrix()
    position = at + 0.004 * rng.normal(size=(n, 3))
    position[-1] = [0.0, 0.0, 7.0]
    twist = TWIST * rng.normal(size=(n, 6))
    return turns @ R, position, twist, np.full(n, np.nan)


@pytest.mark.slow
def test_frames_from_c_are_those_from_python(scene, library):
    """Twists given, then estimated from times; amid a swap of fields, drag included."""
    field, law = pressing(scene, DRAG), tt.BlendLaw(force_rate=5.0, reserve=1.0)
    new = scaled(field, 1.5)
    rotation, position, twist, time_ = poses_of(scene)
    clock = 1e-3 * np.arange(len(time_))
    by_python, by_c = (Renderer(field, scene.shell, blend=law) for _ in "ab")
    out, shares = np.zeros(6), []
    for times in (time_, clock, time_):
        for renderer in (by_python, by_c):
            renderer.update(new)
        c = CLoop(library, by_c, (rotation, position, twist, times))
        c.run()
        for k in range(len(times)):
            motion = {"twist": twist[k]} if np.isnan(times[k]) else {"time": times[k]}
            count = by_python.render_into(rotation[k], position[k], out, **motion)
            assert count == c.count[k]
            np.testing.assert_array_equal(c.wrench[k], out)
            shares.append(by_python.blend.progress)
        assert by_c.blend == by_python.blend
        field, new = new, field
    assert (c.count > 0).sum() > 10
    assert (c.count == -1).sum() >= 1
    assert sum(0.0 < share < 1.0 for share in shares) > 10


def test_a_caller_in_c_sees_what_limited_a_frame(library):
    """The header's function against `Wrench.limited_by`, frame by frame."""
    scene = small_scene("trilinear")
    R, at = deepest_pose(scene)
    zero = (ctypes.c_double * 6)()
    seen = set()
    for force, torque in ((40.0, 4.0), (0.1, 4.0), (40.0, 1e-4)):
        renderer = Renderer(
            pressing(scene), scene.shell, force_limit=force, torque_limit=torque
        )
        given, wrench = renderer.c_function(), (ctypes.c_double * 6)()
        for shift in (0.0, 7.0):
            position = at + np.array([0.0, 0.0, shift])
            pose = [(ctypes.c_double * v.size)(*v.ravel()) for v in (R, position)]
            given.call(given.context, *pose, zero, float("nan"), wrench)
            expected = renderer.render(R, position).limited_by
            code = library.last_limit(ctypes.c_void_p(given.context))
            assert LIMITS[code] == expected
            seen.add(expected)
    assert {"", "force", "torque"} <= seen


@pytest.mark.slow
def test_one_function_for_all_and_one_context_for_each(scene):
    renderer = Renderer(pressing(scene), scene.shell)
    first, second = renderer.c_function(), renderer.c_function()
    other = Renderer(pressing(scene), scene.shell).c_function()
    assert first.function == second.function == other.function == frame_address()
    assert first.context == second.context != other.context


def test_bad_input_has_a_code_and_leaves_the_wrench(scene):
    given = Renderer(pressing(scene, DRAG), scene.shell).c_function()
    R, at = (np.ascontiguousarray(a) for a in deepest_pose(scene))
    call, nan = given.call, float("nan")

    def frame(R, at, twist, time):
        wrench = np.full(6, 7.0)
        pointers = [np.ascontiguousarray(a, dtype=float) for a in (R, at, twist)]
        reals = [a.ctypes.data_as(REAL) for a in (*pointers, wrench)]
        return call(given.context, *reals[:3], time, reals[3]), wrench

    text = HEADER.read_text()
    for code, bad in (
        ("TTUS_BAD_POSE = -2", (2.0 * R, at, TWIST, nan)),
        ("TTUS_BAD_POSE = -2", (R, at * np.nan, TWIST, nan)),
        ("TTUS_BAD_TWIST = -3", (R, at, TWIST * np.inf, nan)),
        ("TTUS_BAD_TIME = -4", (R, at, TWIST, np.inf)),
    ):
        found, wrench = frame(*bad)
        assert code in text
        assert found == int(code.split()[-1])
        assert (wrench == 7.0).all()
    assert "TTUS_OFF_GRID = -1" in text
    found, wrench = frame(R, [0.0, 0.0, 7.0], TWIST, nan)
    assert found == -1 and not wrench.any()
    # in float32 the matrix is off by its rounding, and taken for the rotation it was
    exact, rounded = frame(R, at, TWIST, nan), frame(np.float32(R), at, TWIST, nan)
    assert exact[0] > 0 and abs(rounded[0] - exact[0]) <= 2
    np.testing.assert_allclose(rounded[1], exact[1], atol=1e-3)


def test_updates_reach_a_running_loop_and_never_jump(scene, library):
    """Fields come and go under a loop in C: all that it reads stays where it is."""
    field, law = pressing(scene), tt.BlendLaw(force_rate=5.0, reserve=1.0)
    renderer = Renderer(field, scene.shell, blend=law)
    R, at = deepest_pose(scene)
    once = (R[None], at[None], np.zeros((1, 6)), np.full(1, np.nan))
    c = CLoop(library, renderer, once, rounds=-1)
    c.start()
    try:
        for scale in np.random.default_rng(0).uniform(0.5, 1.5, 40):
            before = c.loop.frames
            renderer.update(scaled(field, scale))
            until = time.monotonic() + 10.0
            while c.loop.frames < before + 20 and time.monotonic() < until:
                time.sleep(1e-4)
            assert c.loop.frames >= before + 20  # the loop goes on
    finally:
        c.join()
    assert renderer._c is not None and renderer._c.words[WAITING] == 0
    out, fresh = np.zeros(6), Renderer(field, scene.shell)
    away = CLoop(library, renderer, (R[None], at[None] + 1.0, *once[2:]))
    away.run()  # in the air the swap ends
    assert renderer.blend.progress == 1.0
    last = CLoop(library, renderer, once)
    last.run()
    fresh.render_into(R, at, out)
    np.testing.assert_allclose(last.wrench[0], scale * out, rtol=1e-12)


def test_a_frame_leaves_the_ledger_to_a_waiting_update(scene, library):
    field = pressing(scene)
    renderer = Renderer(field, scene.shell)
    R, at = deepest_pose(scene)
    once = (R[None], at[None], np.zeros((1, 6)), np.full(1, np.nan))
    CLoop(library, renderer, once).run()
    renderer.update(scaled(field, 0.5))
    renderer._c.pause()
    before = renderer._fields.pair.ledger.copy()
    CLoop(library, renderer, once).run()
    np.testing.assert_array_equal(renderer._fields.pair.ledger, before)
    renderer._c.resume(renderer._fields.pair)
    CLoop(library, renderer, once).run()
    assert renderer.blend.progress > 0.0


@pytest.mark.slow
def test_the_how_to_page_runs(scene, tmp_path):
    """Its C++ loop and its Python host, as they are printed."""
    page = Path(__file__).parents[2] / "docs" / "how-to" / "rendering-cpp.md"
    if shutil.which("c++") is None or not page.exists():
        pytest.skip("no C++ compiler or no documentation here")
    blocks = re.findall(r'```\w+ title="(\S+)"\n(.*?)```', page.read_text(), re.S)
    for name, text in blocks:
        quick = text.replace("...  #", "import time; time.sleep(0.1)  #")
        (tmp_path / name).write_text(quick)
    pressing(scene).save(tmp_path / "patient.nc")
    done = python("host.py", cwd=tmp_path, PYTHONPATH=str(page.parents[2]))
    assert re.fullmatch(r"[1-9]\d+ frames", done.stdout.strip())


def test_an_update_gives_up_on_a_frame_that_never_ends(scene, monkeypatch):
    renderer = Renderer(pressing(scene), scene.shell)
    renderer.c_function()
    renderer._c.words[DONE] -= 1
    monkeypatch.setattr(c_interface, "PATIENCE", 0.01)
    with pytest.raises(TtusError, match=r"has not ended within 0\.01 s"):
        renderer.update(pressing(scene))
    assert renderer._c.words[WAITING] == 0

from __future__ import annotations

import itertools
import subprocess
import sys
import threading
import tracemalloc
from collections.abc import Callable

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.conftest import small_scene, torso
from ttus_opt.contact import contact_rows
from ttus_opt.errors import InputError, TtusWarning
from ttus_opt.field import PotentialField
from ttus_opt.haptic_blend import BlendLaw
from ttus_opt.haptic_wrench import render_frame
from ttus_opt.point_shell import PointShell
from ttus_opt.renderer import Renderer
from ttus_opt.scene import Scene
from ttus_opt.voxmap import Voxmap


def random_field(scene: Scene) -> PotentialField:
    values = np.random.default_rng(1).normal(size=scene.voxmap.grid.shape)
    return PotentialField(scene.voxmap, values, scene.sampling)


def test_render_is_the_row_of_the_fit(scene: Scene) -> None:
    """render(pose) == (N(pose) p, W(pose) p), the law of design §3."""
    field = random_field(scene)
    renderer = Renderer(field, scene.shell)
    force = (scene.N @ field.values.reshape(-1)).reshape(-1, 3)
    torque = (scene.W @ field.values.reshape(-1)).reshape(-1, 3)
    touched = 0
    for t in range(len(scene.trajectory)):
        wrench = renderer.render(
            scene.trajectory.rotation[t], scene.trajectory.position[t]
        )
        assert wrench.in_grid
        assert wrench.contact_points == scene.rows.contact_points[t]
        touched += wrench.contact_points > 0
        np.testing.assert_allclose(wrench.force, force[t], rtol=0, atol=1e-12)
        np.testing.assert_allclose(wrench.torque, torque[t], rtol=0, atol=1e-13)
    assert touched > 5


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
def test_the_law_at_five_thousand_points(sampling: str) -> None:
    """Random poses, from the air to half sunk and over the ends of the grid."""
    rng = np.random.default_rng(7)
    surface = torso(180, 61)
    voxmap = Voxmap.from_surface(surface, shape=(48, 120, 60), r_inner=0.03)
    shell = PointShell.ellipsoid(semi_axes=(0.03, 0.0125, 0.018), n_points=5000)
    values = rng.normal(size=voxmap.grid.shape)
    renderer = Renderer(PotentialField(voxmap, values, sampling), shell)
    rotation = Rotation.random(60, rng=rng).as_matrix()
    angle, z = rng.uniform(0, 2 * np.pi, 60), rng.uniform(-0.02, 0.22, 60)
    r = surface.radius_at(angle, z) + rng.uniform(-0.02, 0.03, 60)
    position = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    rows = contact_rows(voxmap, shell, rotation, position, sampling=sampling)
    force = (rows.N @ values.reshape(-1)).reshape(-1, 3)
    torque = (rows.W @ values.reshape(-1)).reshape(-1, 3)
    assert (rows.contact_points > 500).sum() > 20
    assert (rows.contact_points == 0).sum() > 2
    out = np.empty(6)
    for t in range(60):
        wrench = renderer.render(rotation[t], position[t])
        assert wrench.contact_points == rows.contact_points[t]
        assert wrench.in_grid == rows.in_grid[t]
        assert wrench.beyond_inner == rows.beyond_inner[t]
        np.testing.assert_allclose(wrench.force, force[t], rtol=0, atol=2e-12)
        np.testing.assert_allclose(wrench.torque, torque[t], rtol=0, atol=1e-13)
        count = renderer.render_into(rotation[t], position[t], out)
        assert count == (wrench.contact_points if wrench.in_grid else -1)
        np.testing.assert_array_equal(out, [*wrench.force, *wrench.torque])


def least_memory(frame: Callable[[], object]) -> tuple[int, int]:
    """Bytes that 2,000 frames leave and at most hold: the least of five rounds.

    Python's count is of the whole process. A progress bar's thread of an earlier test,
    or the collection of its garbage, may fall into one round; what a frame allocates is
    in each.
    """
    rounds = []
    tracemalloc.start()
    try:
        for _ in range(6):  # the first fills the interpreter's lists of spare objects
            tracemalloc.reset_peak()
            before = tracemalloc.get_traced_memory()[0]
            for _ in range(2000):
                frame()
            now, peak = tracemalloc.get_traced_memory()
            rounds.append((now - before, peak - before))
    finally:
        tracemalloc.stop()
    kept, peaks = zip(*rounds[1:], strict=True)
    return min(kept), min(peaks)


def test_nothing_is_compiled_or_allocated_in_a_frame(scene: Scene) -> None:
    """Whatever layout a pose has; also while a swap of fields is under way."""
    field = random_field(scene)
    renderer = Renderer(field, scene.shell, blend=BlendLaw(force_rate=1e-9))
    known = list(render_frame.signatures)
    out = np.zeros(6)
    trajectory = scene.trajectory
    k = int(scene.rows.contact_points.argmax())
    R, at = trajectory.rotation[k].copy(), trajectory.position[k].copy()
    frozen = R.copy()
    frozen.setflags(write=False)
    straight = renderer.render(R, at).force
    for rotation in (np.asfortranarray(R), frozen, R.tolist(), np.stack([R, R], 2)):
        pose = rotation[..., 0] if np.ndim(rotation) == 3 else rotation
        np.testing.assert_array_equal(renderer.render(pose, at).force, straight)
    twist, clock = np.array([0.02, 0.01, 0.03, 0.5, 0.1, -0.2]), itertools.count()
    frames: dict[str, Callable[[], object]] = {
        "settled": lambda: renderer.render_into(R, at, out),
        "swapping": lambda: renderer.render_into(R, at, out),
        "dragging": lambda: renderer.render_into(R, at, out, twist),
        "estimating": lambda: renderer.render_into(R, at, out, time=1e-3 * next(clock)),
    }
    drag = {"friction_coefficient": 0.3}
    for stage, frame in frames.items():
        kept, peak = least_memory(frame)
        assert kept < 200, stage  # a tenth of a byte per frame
        assert peak < 2100, stage  # numba's fingerprint of one call's arguments
        values = 2 * field.values if stage == "settled" else field.values
        renderer.update(PotentialField(field.voxmap, values, field.sampling, drag))
    assert renderer.blend.progress < 1.0
    assert list(render_frame.signatures) == known


def test_a_frame_leaves_no_trace_in_the_next(scene: Scene) -> None:
    renderer = Renderer(random_field(scene), scene.shell)
    poses = list(zip(scene.trajectory.rotation, scene.trajectory.position, strict=True))
    first = [renderer.render(*pose).force for pose in poses]
    again = [renderer.render(*pose).force for pose in reversed(poses)]
    np.testing.assert_array_equal(first, again[::-1])


def test_results_are_the_callers_own(scene: Scene) -> None:
    """A wrench kept by the caller is not overwritten by a later frame."""
    renderer = Renderer(random_field(scene), scene.shell)
    trajectory = scene.trajectory
    kept = renderer.render(trajectory.rotation[0], trajectory.position[0])
    before = kept.force.copy()
    renderer.render(trajectory.rotation[1], trajectory.position[1])
    np.testing.assert_array_equal(kept.force, before)


def test_outside_the_grid_is_zero_and_says_so(scene: Scene) -> None:
    wrench = Renderer(random_field(scene), scene.shell).render(
        np.eye(3), np.array([0.0, 0.0, 7.0])
    )
    assert not wrench.in_grid
    assert wrench.contact_points == 0
    assert not wrench.force.any()
    assert not wrench.torque.any()


@pytest.mark.parametrize(
    ("rotation", "position", "word"),
    [
        (np.eye(4), np.zeros(3), r"\(3, 3\)"),
        (np.eye(3), np.zeros(2), r"\(3,\)"),
        (np.eye(3) * 1.1, np.zeros(3), "orthonormal"),
        (np.full((3, 3), np.nan), np.zeros(3), "NaN"),
        (np.eye(3), np.array([0.0, np.nan, 0.0]), "NaN"),
        (np.eye(3), np.array([0.0, np.inf, 0.0]), "NaN or infinite"),
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3), "reflection .determinant −1."),
        (-np.eye(3), np.zeros(3), "reflection"),
    ],
)
def test_unusable_poses(
    scene: Scene, rotation: np.ndarray, position: np.ndarray, word: str
) -> None:
    renderer = Renderer(random_field(scene), scene.shell)
    with pytest.raises(InputError, match=word):
        renderer.render(rotation, position)


def test_rendering_loads_no_modelling_package() -> None:
    program = (
        "import sys, ttus_opt; ttus_opt.Renderer, ttus_opt.PotentialField\n"
        "print([m for m in ('cvxpy', 'qpsolvers', 'cv2', 'matplotlib')"
        " if m in sys.modules])"
    )
    out = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    )
    assert out.stdout.strip() == "[]"


def test_a_field_loaded_from_file_renders_the_same(tmp_path: object) -> None:
    scene = small_scene("trilinear")
    field = random_field(scene)
    field.save(f"{tmp_path}/field.nc")
    loaded = PotentialField.load(f"{tmp_path}/field.nc")
    R, at = scene.trajectory.rotation[3], scene.trajectory.position[3]
    np.testing.assert_array_equal(
        Renderer(loaded, scene.shell).render(R, at).force,
        Renderer(field, scene.shell).render(R, at).force,
    )
    rows = contact_rows(loaded.voxmap, scene.shell, R[None], at[None])
    assert rows.contact_points[0] == scene.rows.contact_points[3]


def test_the_callers_field_is_not_the_renderers(scene: Scene) -> None:
    """Changing an array after it was handed over changes no force."""
    values = np.random.default_rng(2).normal(size=scene.voxmap.grid.shape)
    renderer = Renderer(
        PotentialField(scene.voxmap, values, scene.sampling), scene.shell
    )
    k = int(scene.rows.contact_points.argmax())
    pose = scene.trajectory.rotation[k], scene.trajectory.position[k]
    before = renderer.render(*pose).force
    values *= 2.0
    np.testing.assert_array_equal(renderer.render(*pose).force, before)


def test_an_update_before_the_first_frame_is_simply_taken(scene: Scene) -> None:
    field = random_field(scene)
    renderer = Renderer(field, scene.shell)
    new = PotentialField(field.voxmap, 3 * field.values, field.sampling)
    renderer.update(new)
    assert renderer.blend.progress == 1.0
    k = int(scene.rows.contact_points.argmax())
    pose = scene.trajectory.rotation[k], scene.trajectory.position[k]
    np.testing.assert_array_equal(
        renderer.render(*pose).force, Renderer(new, scene.shell).render(*pose).force
    )


@pytest.mark.parametrize("what", ["sampling", "grid", "surface"])
def test_an_update_must_fit(what: str) -> None:
    scene = small_scene("trilinear")
    renderer = Renderer(random_field(scene), scene.shell)
    voxmap, sampling = scene.voxmap, "trilinear"
    if what == "sampling":
        sampling = "voxel-mean"
    elif what == "grid":
        voxmap = Voxmap.from_surface(voxmap.surface, shape=(9, 20, 11), r_inner=0.03)
    else:
        voxmap = Voxmap(voxmap.grid, torso(40, 12), voxmap.region)
    with pytest.raises(InputError, match=f"keep the field's {what}"):
        renderer.update(PotentialField(voxmap, np.zeros(voxmap.grid.shape), sampling))


def test_updates_from_another_thread_never_jump_nor_stop_the_frames(
    scene: Scene,
) -> None:
    """A standing probe feels a slow change, and in the air the last field holds."""
    field = random_field(scene)
    law = BlendLaw(force_rate=5.0, reserve=1.0)
    renderer = Renderer(field, scene.shell, blend=law)
    fields = [
        PotentialField(field.voxmap, s * field.values, field.sampling)
        for s in np.random.default_rng(5).uniform(0.2, 3.0, 25)
    ]
    k = int(scene.rows.contact_points.argmax())
    pose = scene.trajectory.rotation[k], scene.trajectory.position[k]
    before = renderer.render(*pose).force
    failures: list[BaseException] = []

    def feed() -> None:
        try:
            for new in fields:
                renderer.update(new)
        except BaseException as error:
            failures.append(error)

    thread = threading.Thread(target=feed)
    thread.start()
    frames = 0
    while thread.is_alive() or frames < 200:
        after = renderer.render(*pose).force
        assert np.linalg.norm(after - before) <= 5e-3 * (1 + 1e-9)
        before = after
        frames += 1
    thread.join()
    assert not failures
    renderer.render(np.eye(3), np.array([0.0, 0.0, 7.0]))
    assert renderer.blend.progress == 1.0
    np.testing.assert_array_equal(
        renderer.render(*pose).force,
        Renderer(fields[-1], scene.shell).render(*pose).force,
    )


def test_out_must_hold_a_wrench(scene: Scene) -> None:
    renderer = Renderer(random_field(scene), scene.shell)
    with pytest.raises(InputError, match=r"\(6,\), got \(3,\)"):
        renderer.render_into(np.eye(3), np.zeros(3), np.zeros(3))


DRAG = {"friction_coefficient": 0.3}
TWIST = np.array([0.03, -0.02, 0.05, 0.4, 0.2, -0.3])


def pressing(
    scene: Scene, parameters: dict[str, float] | None = None
) -> PotentialField:
    """The Laplace field of a scene, which pushes."""
    values = scene.voxmap.grid.unflatten(scene.laplace.solve(scene.b))
    return PotentialField(scene.voxmap, values, scene.sampling, parameters or {})


def deepest_pose(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    k = int(scene.rows.contact_points.argmax())
    return scene.trajectory.rotation[k], scene.trajectory.position[k]


def test_drag_without_a_motion_is_left_out_and_told_once(scene: Scene) -> None:
    renderer = Renderer(pressing(scene, DRAG), scene.shell)
    pose = deepest_pose(scene)
    with pytest.warns(TtusWarning, match="friction_coefficient.*give render a twist"):
        first = renderer.render(*pose)
    assert first.drag == "left out"
    assert renderer.render(*pose).drag == "left out"  # a second warning would fail
    bare = Renderer(pressing(scene), scene.shell).render(*pose, TWIST)
    np.testing.assert_array_equal(first.force, bare.force)
    assert bare.drag == "none"
    moved = renderer.render(*pose, TWIST)
    assert moved.drag == "given"
    assert np.linalg.norm(moved.force - first.force) > 0.1
    # a twist is of its own frame only
    np.testing.assert_array_equal(renderer.render(*pose).force, first.force)


def test_drag_that_comes_with_an_update_is_told_too(scene: Scene) -> None:
    renderer, pose = Renderer(pressing(scene), scene.shell), deepest_pose(scene)
    assert renderer.render(*pose).drag == "none"
    renderer.update(pressing(scene, {"viscous_coefficient": 3.0}))
    with pytest.warns(TtusWarning, match=r"drag \(viscous_coefficient\)"):
        assert renderer.render(*pose).drag == "left out"


@pytest.mark.parametrize(
    ("motion", "word"),
    [
        ({"twist": np.zeros(3)}, r"angular velocity .*\(6,\), got \(3,\)"),
        ({"twist": np.full(6, np.nan)}, "twist contains NaN"),
        ({"twist": np.zeros(6), "time": 0.0}, "twist or time, not both"),
        ({"time": float("nan")}, "time must be finite"),
        ({"time": float("inf")}, "time must be finite and not go back"),
        ({"time": -1.0}, "not go back .*got -1.0 after 0.0"),
    ],
)
def test_unusable_motions(motion: dict[str, object], word: str) -> None:
    scene = small_scene("trilinear")
    renderer, pose = Renderer(pressing(scene, DRAG), scene.shell), deepest_pose(scene)
    renderer.render(*pose, time=0.0)
    with pytest.raises(InputError, match=word):
        renderer.render(*pose, **motion)  # type: ignore[arg-type]
    with pytest.raises(InputError, match=word):
        renderer.render_into(*pose, np.zeros(6), **motion)  # type: ignore[arg-type]


def test_drag_of_an_estimated_motion(scene: Scene) -> None:
    """Of a steady slide, its twist's; of a hand at rest, next to none and then none."""
    field = pressing(scene, DRAG)
    renderer, other = Renderer(field, scene.shell), Renderer(field, scene.shell)
    bare = Renderer(pressing(scene), scene.shell)
    (R, at), velocity = deepest_pose(scene), np.array([0.02, 0.0, -0.03])
    twist = np.concatenate([velocity, np.zeros(3)])
    out = np.zeros(6)
    for k in range(400):
        place = at + (k - 399) * 1e-3 * velocity
        found = renderer.render(R, place, time=5.0 + 1e-3 * k)
    assert found.drag == "estimated"
    expected, contact = other.render(R, place, twist), bare.render(R, place)
    np.testing.assert_allclose(found.force, expected.force, atol=1e-6)
    assert np.linalg.norm(expected.force - contact.force) > 0.1
    rng = np.random.default_rng(2)
    for k in range(3000):  # a hand at rest, seen with ±0.05 mm
        noisy = place + rng.uniform(-5e-5, 5e-5, 3)
        renderer.render_into(R, noisy, out, time=5.4 + 1e-3 * k)
        still = bare.render(R, noisy).force
        drag = np.linalg.norm(out[:3] - still) / np.linalg.norm(still)
        assert drag < (1e-6 if k > 2500 else 0.05 if k > 200 else 0.31), k


def test_the_force_limit_shortens_the_wrench(scene: Scene) -> None:
    field, pose = pressing(scene, DRAG), deepest_pose(scene)
    free = Renderer(field, scene.shell).render(*pose, TWIST)
    size = float(np.linalg.norm(free.force))
    assert not free.saturated
    cut = Renderer(field, scene.shell, force_limit=0.4 * size).render(*pose, TWIST)
    assert cut.saturated
    np.testing.assert_allclose(cut.force, 0.4 * free.force, rtol=1e-12)
    np.testing.assert_allclose(cut.torque, 0.4 * free.torque, rtol=1e-12)
    whole = Renderer(field, scene.shell, force_limit=1.01 * size).render(*pose, TWIST)
    assert not whole.saturated
    np.testing.assert_array_equal(whole.force, free.force)
    for limit in (0.0, -1.0, float("nan")):
        with pytest.raises(InputError, match="force_limit must be positive"):
            Renderer(field, scene.shell, force_limit=limit)


def scratch_of(renderer: Renderer) -> dict[str, np.ndarray]:
    """Copies of all that a frame writes and the next call might read."""
    stage, desk = renderer._stage, renderer._desk
    names = ("place", "near", "node", "touched", "depth", "voxel", "share", "hits")
    arrays = {name: getattr(stage, name) for name in names} | desk._asdict()
    arrays["ledger"] = renderer._fields.pair.ledger
    return {name: array.copy() for name, array in arrays.items()}


@pytest.mark.parametrize("call", ["warm_up", "update"])
def test_other_threads_calls_leave_a_frames_scratch_alone(
    scene: Scene, call: str
) -> None:
    """A frame may be half done when another thread updates or compiles."""
    field = pressing(scene, DRAG)
    renderer = Renderer(field, scene.shell, blend=BlendLaw(force_rate=1e-9))
    pose = deepest_pose(scene)
    renderer.render(*pose, TWIST)
    renderer.update(PotentialField(field.voxmap, 2 * field.values, field.sampling))
    renderer.render(*pose, TWIST)
    before, stage = scratch_of(renderer), renderer._stage
    if call == "warm_up":
        renderer.warm_up()
    else:  # amid a swap, so that two drags are mixed at the last pose
        renderer.update(field)
    after = scratch_of(renderer)
    assert renderer._stage is stage
    for name, array in before.items():
        if name != "ledger" or call == "warm_up":
            np.testing.assert_array_equal(after[name], array, err_msg=name)


def test_frames_give_way_to_an_update(scene: Scene) -> None:
    """While an update wants the turn, frames render and do not take it."""
    field, pose = pressing(scene), deepest_pose(scene)
    renderer = Renderer(field, scene.shell)
    renderer.render(*pose)
    renderer.update(PotentialField(field.voxmap, 0.5 * field.values, field.sampling))
    renderer._waiting = True
    before = renderer._fields.pair.ledger.copy()
    force = renderer.render(*pose).force
    np.testing.assert_array_equal(renderer._fields.pair.ledger, before)
    renderer._waiting = False
    assert np.linalg.norm(renderer.render(*pose).force) < np.linalg.norm(force)
    assert renderer.blend.progress > 0.0


def test_updates_come_one_after_the_other(scene: Scene) -> None:
    """A second update still waiting keeps its claim when the first one ends."""
    field = pressing(scene)
    renderer, claims = Renderer(field, scene.shell), []
    threads = [threading.Thread(target=renderer.update, args=(field,)) for _ in "ab"]
    swapped = renderer._swapped

    def watched(*arguments: object) -> object:
        if not claims:
            claims.append(renderer._waiting)
            threads[1].start()
            while not renderer._updates.locked():
                pass
            threads[1].join(0.2)  # it waits, for the turn or for its place
        else:
            threads[0].join(5.0)
            claims.append(renderer._waiting)
        return swapped(*arguments)  # type: ignore[arg-type]

    renderer._swapped = watched  # type: ignore[method-assign,assignment]
    threads[0].start()
    threads[0].join(10.0)
    threads[1].join(10.0)
    assert claims == [True, True]

"""Recordings that were read wrongly are told, with the option that mends them."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from ttus_opt import example
from ttus_opt.errors import InputError
from ttus_opt.fitting.sanity import SanityReport, check_recordings
from ttus_opt.probe.trajectory import Trajectory

SWAP = [1, 0, 2]


@functools.cache
def geometry() -> tuple[tt.Voxmap, tt.PointShell]:
    surface = tt.Surface.load(example.path("surface.nc"))
    voxmap = tt.Voxmap.from_surface(surface, shape=(20, 48, 24), r_inner=0.03)
    return voxmap, tt.PointShell.from_spec(example.PROBE, n_points=400)


@functools.cache
def recording(name: str) -> Trajectory:
    return tt.read_trajectory(example.path(f"{name}.csv"))


def report(trajectory: Trajectory, shell: tt.PointShell | None = None) -> SanityReport:
    voxmap, own = geometry()
    scene = tt.Scene.assemble(
        voxmap, shell or own, trajectory, inner=10.0, sampling="trilinear"
    )
    # which field is of no matter to what the mistake is
    return check_recordings(scene, tt.fit(scene, "laplace_only").field)


def in_tool_axes(t: Trajectory) -> Trajectory:
    turn = t.rotation.transpose(0, 2, 1)
    return replace(
        t,
        force=(turn @ t.force[..., None])[..., 0],
        torque=(turn @ t.torque[..., None])[..., 0],
    )


def flipped(t: Trajectory) -> Trajectory:
    return replace(t, force=-t.force, torque=-t.torque)


def misread(t: Trajectory) -> Trajectory:
    q = t.quat_wxyz[:, [1, 2, 3, 0]]
    return replace(t, rotation=Rotation.from_quat(q, scalar_first=True).as_matrix())


def late(t: Trajectory) -> Trajectory:
    return replace(t, force=np.roll(t.force, 4, 0), torque=np.roll(t.torque, 4, 0))


MISTAKES: dict[str, Callable[[Trajectory], Trajectory]] = {
    "--flip-wrench": flipped,
    "--wrench-frame tool": in_tool_axes,
    "--wrench-frame tool --flip-wrench": lambda t: flipped(in_tool_axes(t)),
    "--quaternion xyzw": misread,
    "--torque-unit Nmm": lambda t: replace(t, torque=1e3 * t.torque),
    "--columns px=py,py=px": lambda t: replace(t, position=t.position[:, SWAP]),
    "--columns fx=fy,fy=fx,tx=ty,ty=tx": lambda t: replace(
        t, force=t.force[:, SWAP], torque=t.torque[:, SWAP]
    ),
}


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
@pytest.mark.parametrize("name", ["press_fit", "sweep_fit", "sweep_drag_fit"])
def test_sound_recordings_are_not_doubted(name: str) -> None:
    found = report(recording(name))
    assert found.mistake is None
    assert found.recordings[0].force_without_contact == 0


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
@pytest.mark.parametrize("mends", MISTAKES)
def test_a_mistake_is_named_with_the_option_that_mends_it(mends: str) -> None:
    found = report(MISTAKES[mends](recording("sweep_fit")))
    assert found.mistake is not None
    assert found.mistake.mends == mends


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_an_offset_in_time_is_told() -> None:
    found = report(late(recording("press_fit")))
    assert found.mistake is not None
    assert found.mistake.mends == "--wrench-delay 0.2"


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_torques_that_nothing_explains_hide_nothing() -> None:
    """A sensor whose torques are noise: its forces still tell the offset in time."""
    noise = np.random.default_rng(0).normal(0.0, 0.1, (400, 3))
    found = report(replace(late(recording("press_fit")), torque=noise))
    assert found.mistake is not None
    assert found.mistake.mends == "--wrench-delay 0.2"


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_torques_about_the_poses_origin_are_told() -> None:
    """A probe whose mesh stands 6 cm beside its frame's origin, as CAD has it."""
    _, shell = geometry()
    offset = np.array([0.0, 0.0, 0.06])
    moved = replace(
        shell, points=shell.points + offset, reference=shell.reference + offset
    )
    own = recording("sweep_fit")
    arm = own.rotation @ offset
    written = replace(
        own,
        position=own.position - arm,
        torque=own.torque + np.cross(arm, own.force),
    )
    found = report(written, moved)
    assert found.mistake is not None
    assert found.mistake.mends == "--torque-about origin"
    assert found.shell_centroid == pytest.approx((0.0, 0.0, 0.06), abs=1e-3)


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_torques_about_a_point_of_the_sensor_are_told() -> None:
    """A sensor 8 cm above the probe and 2 cm beside it, whose place was not told."""
    own = recording("sweep_fit")
    arm = own.rotation @ np.array([0.02, 0.0, 0.08])
    found = report(replace(own, torque=own.torque - np.cross(arm, own.force)))
    assert found.mistake is not None
    option, point = found.mistake.mends.split()
    assert option == "--torque-about"
    told = np.array(point.split(","), dtype=float)
    assert told == pytest.approx([0.02, 0.0, 0.08], abs=0.01)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_residuals_and_contacts_are_those_of_each_recording() -> None:
    voxmap, shell = geometry()
    both = Trajectory.concatenate([recording("press_fit"), recording("sweep_fit")])
    scene = tt.Scene.assemble(voxmap, shell, both, inner="fit", sampling="trilinear")
    field = tt.fit(scene, "eq10").field
    found = check_recordings(scene, field, ["press", "sweep"])
    assert [check.name for check in found.recordings] == ["press", "sweep"]
    rest = (scene.f - scene.N @ field.values.reshape(-1)).reshape(-1, 3)
    size = np.linalg.norm(rest, axis=1)
    for part, check in zip(np.split(size, [400]), found.recordings, strict=True):
        assert check.force_residual_N == pytest.approx(part.mean(), rel=1e-6)
    touching = scene.rows.contact_points[:400] > 0
    silent = np.linalg.norm(scene.f.reshape(-1, 3)[:400], axis=1) <= 0.5
    assert found.recordings[0].contact_without_force == (touching & silent).sum() > 0


def test_poses_alone_cannot_be_checked() -> None:
    voxmap, shell = geometry()
    poses = replace(recording("press_fit"), force=None, torque=None)
    scene = tt.Scene.assemble(voxmap, shell, poses)
    with pytest.raises(InputError, match="no wrenches"):
        check_recordings(scene, tt.fit(scene, "laplace_only").field)


def test_the_probe_is_told_in_millimetres() -> None:
    found = SanityReport((), (0.06, 0.025, 0.036), (0.0123, -0.004, 0.0), 0.1, None)
    assert found.lines == [
        "probe: 60 × 25 × 36 mm, centroid at (12.3, -4.0, 0.0) mm of its frame"
    ]


def test_hysteresis_is_told_where_there_is_some() -> None:
    found = report(recording("press_fit")).recordings[0]
    assert abs(found.hysteresis_share) < 0.05 and "hysteresis" not in str(found)
    assert str(replace(found, hysteresis_share=0.3)).endswith(", 30 % hysteresis")

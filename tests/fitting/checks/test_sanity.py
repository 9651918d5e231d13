"""Recordings that were read wrongly are told, with the option that mends them.

Agreement with the geometry against SciPy; torques about an exactly known point.

Recordings of forces alone: the fit is that without torque rows, everywhere.
"""

import functools
import re
from dataclasses import replace

import numpy as np
import pytest
import scipy.optimize
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import InputError, presses, small_scene, torso, with_wrenches
from ttus_opt import example
from ttus_opt.contact.scene import ScenePlan
from ttus_opt.fitting.checks import sanity
from ttus_opt.probe.conventions import Conventions

SWAP = [1, 0, 2]


@functools.cache
def geometry():
    surface = tt.Surface.load(example.path("surface.nc"))
    voxmap = tt.Voxmap.from_surface(surface, shape=(12, 32, 16), r_inner=0.03)
    return voxmap, tt.PointShell.from_spec(example.PROBE, n_points=150)


@functools.cache
def recording(name):
    return tt.read_trajectory(example.path(f"{name}.csv"))


def report(trajectory, shell=None):
    voxmap, own = geometry()
    scene = tt.Scene.assemble(
        voxmap, shell or own, trajectory, inner=10.0, sampling="trilinear"
    )
    # which field is of no matter to what the mistake is
    return sanity.check_recordings(scene, tt.fit(scene, "laplace_only").field)


def in_tool_axes(t):
    turn = t.rotation.transpose(0, 2, 1)
    return replace(
        t,
        force=(turn @ t.force[..., None])[..., 0],
        torque=(turn @ t.torque[..., None])[..., 0],
    )


def flipped(t):
    return replace(t, force=-t.force, torque=-t.torque)


def misread(t):
    q = t.quat_wxyz[:, [1, 2, 3, 0]]
    return replace(t, rotation=Rotation.from_quat(q, scalar_first=True).as_matrix())


def late(t):
    force, torque = (np.roll(values, 4, 0) for values in (t.force, t.torque))
    return replace(t, force=force, torque=torque)


#: The option that mends a mistake: what was written, and how it is told
MISTAKES = {
    "--flip-wrench": (flipped, "forces of the opposite sign"),
    "--wrench-frame tool": (in_tool_axes, "wrenches in the tool's axes"),
    "--wrench-frame tool --flip-wrench": (
        lambda t: flipped(in_tool_axes(t)),
        "wrenches in the tool's axes and forces of the opposite sign",
    ),
    "--quaternion xyzw": (misread, "quaternions x, y, z, w"),
    "--columns px=py,py=px": (
        lambda t: replace(t, position=t.position[:, SWAP]),
        "columns px and py swapped",
    ),
    "--columns fx=fy,fy=fx,tx=ty,ty=tx": (
        lambda t: replace(t, force=t.force[:, SWAP], torque=t.torque[:, SWAP]),
        "columns fx and fy, tx and ty swapped",
    ),
}


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
@pytest.mark.parametrize("name", ["press_fit", "sweep_fit", "sweep_drag_fit"])
def test_sound_recordings_are_not_doubted(name):
    found = report(recording(name))
    assert found.mistake is None
    assert found.recordings[0].force_without_contact == 0


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_a_frame_in_air_agrees_with_some_convention_by_chance():
    """Which is told of no mistake, as 0.15 instead of 1 was."""
    alone = recording("press_fit")
    alone = alone.select(np.argmin(np.abs(alone.force).sum(axis=1))[None])
    assert report(alone).mistake is None


def assert_told(found, what, mends):
    """In the same words, with how much better the geometry agrees."""
    assert (found.what, found.mends) == (what, mends)
    assert found.after < 0.7 * found.before
    better = f"{found.before:.2g} → {found.after:.2g}"
    assert str(found) == (
        f"{what}? Disagreement with the geometry {better}: read them with "
        f"{mends or 'none of those options'}"
    )


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
@pytest.mark.parametrize("mends", MISTAKES)
def test_a_mistake_is_named_with_the_option_that_mends_it(mends):
    written, what = MISTAKES[mends]
    assert_told(report(written(recording("sweep_fit"))).mistake, what, mends)


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_an_option_that_was_given_for_nothing_is_to_be_left_out():
    """Taken for wrenches of the tool's axes on the patient, which they are not."""
    told = Conventions(wrench_frame="tool", flip_wrench=True)
    written, (voxmap, shell) = recording("sweep_fit"), geometry()
    read = told.read(written, np.asarray(shell.reference))
    scene = tt.Scene.assemble(voxmap, shell, read, sampling="trilinear")
    what = "wrenches in the patient's axes and forces of the opposite sign"
    assert_told(sanity.likely_mistake(scene, written, told)[1], what, "")


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_torques_in_another_unit_are_told_by_their_size():
    own = recording("sweep_fit")
    found = report(replace(own, torque=1e3 * own.torque)).mistake
    assert re.fullmatch(
        r"torques in N mm, \d{3,4} times those expected: read them with "
        "--torque-unit Nmm",
        str(found),
    )


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_the_torques_of_a_ball_tell_no_unit(sign):
    """About its centre none are expected but by rounding, which any torque exceeds."""
    read, (voxmap, _) = recording("press_fit"), geometry()
    ball = tt.PointShell.from_spec("sphere:0.03", n_points=400)
    scene = tt.Scene.assemble(voxmap, ball, read, sampling="trilinear")
    prior = scene.laplace.solve(scene.b)
    frames = replace(read, torque=sign * read.torque)
    assert sanity.agreement(scene, prior, frames)[1] == 0.0


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_torques_that_nothing_explains_hide_nothing():
    """A sensor whose torques are noise: its forces still tell the offset in time."""
    noise = np.random.default_rng(0).normal(0.0, 0.1, (400, 3))
    found = report(replace(late(recording("press_fit")), torque=noise))
    assert found.mistake.mends == "--wrench-delay 0.2"


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_torques_about_the_poses_origin_are_told():
    """A probe whose mesh stands 6 cm beside its frame's origin, as CAD has it."""
    _, shell = geometry()
    offset = np.array([0.0, 0.0, 0.06])
    moved = replace(
        shell, points=shell.points + offset, reference=shell.reference + offset
    )
    own = recording("sweep_fit")
    arm = own.rotation @ offset
    written = replace(
        own, position=own.position - arm, torque=own.torque + np.cross(arm, own.force)
    )
    found = report(written, moved)
    assert_told(found.mistake, "torques about the origin", "--torque-about origin")
    assert found.shell_centroid == pytest.approx((0.0, 0.0, 0.06), abs=1e-3)


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_torques_about_a_point_of_the_sensor_are_told():
    """A sensor 8 cm above the probe and 2 cm beside it, whose place was not told."""
    own = recording("sweep_fit")
    arm = own.rotation @ np.array([0.02, 0.0, 0.08])
    found = report(replace(own, torque=own.torque - np.cross(arm, own.force)))
    option, point = found.mistake.mends.split()
    assert option == "--torque-about"
    told = np.array(point.split(","), dtype=float)
    assert told == pytest.approx([0.02, 0.0, 0.08], abs=0.01)


@pytest.mark.filterwarnings("ignore::ttus_opt.TtusWarning")
def test_residuals_and_contacts_are_those_of_each_recording():
    voxmap, shell = geometry()
    both = tt.Trajectory.concatenate([recording("press_fit"), recording("sweep_fit")])
    scene = tt.Scene.assemble(voxmap, shell, both, inner=10.0, sampling="trilinear")
    field = tt.fit(scene, "laplace_only").field
    found = sanity.check_recordings(scene, field, ["press", "sweep"]).recordings
    assert [(check.name, check.frames) for check in found] == [
        ("press", 400),
        ("sweep", 400),
    ]
    p = field.values.reshape(-1)
    for rows, measured, name in (
        (scene.N, scene.f, "force_residual_N"),
        (scene.W, scene.tau, "torque_residual_Nm"),
    ):
        size = np.linalg.norm((measured - rows @ p).reshape(-1, 3), axis=1)
        told = [getattr(check, name) for check in found]
        assert told == pytest.approx(size.reshape(2, 400).mean(axis=1), rel=1e-6)
    touching = (scene.rows.contact_points > 0).reshape(2, 400)
    silent = (np.linalg.norm(scene.f.reshape(-1, 3), axis=1) <= 0.5).reshape(2, 400)
    told = [(c.contact_without_force, c.force_without_contact) for c in found]
    counts = (touching & silent).sum(axis=1), (~touching & ~silent).sum(axis=1)
    assert told == list(zip(*counts, strict=True))
    assert counts[0][0] > 0
    for names, told in (
        (["press"], ["press part 1", "press part 2"]),  # of one file
        (list("abc"), ["recording 0", "recording 1"]),
    ):
        other = sanity.check_recordings(scene, field, names).recordings
        assert [check.name for check in other] == told


def test_poses_alone_cannot_be_checked():
    voxmap, shell = geometry()
    poses = replace(recording("press_fit"), force=None, torque=None)
    scene = tt.Scene.assemble(voxmap, shell, poses)
    with pytest.raises(InputError, match="no wrenches"):
        sanity.check_recordings(scene, tt.fit(scene, "laplace_only").field)


def test_the_probe_is_told_in_millimetres():
    found = sanity.SanityReport(
        (), (0.06, 0.025, 0.636), (0.1234, -0.004, 0.0), 0.1, None
    )
    assert found.lines == [
        "probe: 60 × 25 × 636 mm, centroid at (123.4, -4.0, 0.0) mm of its frame"
    ]


def test_hysteresis_is_told_where_there_is_some():
    found = report(recording("press_fit")).recordings[0]
    assert abs(found.hysteresis_share) < 0.05 and "hysteresis" not in str(found)
    assert str(replace(found, hysteresis_share=0.3)).endswith(", 30 % hysteresis")


SCENE = small_scene("trilinear")
PRIOR = SCENE.laplace.solve(SCENE.b)
RNG = np.random.default_rng(0)
N = 30
TURN = Rotation.random(N, rng=1).as_matrix()
FORCE = RNG.normal(0.0, 3.0, (N, 3))
EXPECTED = RNG.normal(0.0, 0.1, (N, 3))


def left(expected, measured):
    """The best scale that is not negative, and ‖rest‖²/‖measured‖²."""
    (scale,), rest = scipy.optimize.nnls(expected[:, None], measured)
    return float(scale), float(rest**2 / (measured @ measured))


def test_it_is_the_root_of_what_both_leave():
    frames = SCENE.trajectory
    found = sanity.agreement(SCENE, PRIOR, frames)
    s, of_forces = left(SCENE.N @ PRIOR, frames.force.ravel())
    k, of_torques = left(SCENE.W @ PRIOR, frames.torque.ravel())
    assert 0.0 < of_forces < of_torques
    assert found[0] == pytest.approx(np.sqrt(of_forces * of_torques))
    assert found[1] == pytest.approx(k / s)
    alone = sanity.agreement(SCENE, PRIOR, replace(frames, torque=None))
    assert alone == pytest.approx((of_forces, 0.0))


def test_where_nothing_is_expected_all_disagrees_that_is_measured():
    none = 0.0 * PRIOR
    frames = SCENE.trajectory
    assert sanity.agreement(SCENE, none, frames)[0] == 1.0
    silent = replace(frames, force=0.0 * frames.force, torque=0.0 * frames.torque)
    assert sanity.agreement(SCENE, PRIOR, silent)[0] == 0.0
    assert sanity.agreement(SCENE, none, silent)[1] == 0.0


@pytest.mark.parametrize("factor", [1.0, 7.0])
def test_an_offset_is_found_beside_any_factor(factor):
    c = np.array([0.01, -0.03, 0.08])
    torque = factor * EXPECTED - np.cross(TURN @ c, FORCE)
    assert sanity.torque_offset(torque, EXPECTED, FORCE, TURN) == pytest.approx(c)
    assert sanity.torque_offset(
        factor * EXPECTED, EXPECTED, FORCE, TURN
    ) == pytest.approx(np.zeros(3), abs=1e-12)


def test_pushes_along_one_axis_tell_nothing_along_it():
    force = 3.0 * TURN[:, :, 2]
    c = np.array([0.01, -0.03, 0.08])
    torque = -np.cross(TURN @ c, force)
    found = sanity.torque_offset(torque, np.zeros((N, 3)), force, TURN)
    assert found == pytest.approx([0.01, -0.03, 0.0])


@functools.cache
def scenes():
    """The same presses, with torques and without."""
    surface = torso()
    shell = tt.PointShell.from_spec("ellipsoid:0.02,0.015,0.015", n_points=200)
    own = presses(surface, 12, np.random.default_rng(1))
    plan = ScenePlan((12, 16, 10), inner=5.0, sampling="trilinear")
    whole = plan.build(surface, shell, own)
    return whole, plan.build(surface, shell, replace(own, torque=None))


@pytest.mark.parametrize("solver", ["structured", "closed_form", "clarabel"])
def test_the_fit_is_that_of_forces_alone(solver):
    whole, only = scenes()
    expected = tt.fit(whole, "eq10", solver=solver, force_weight=1.0, torque_weight=0.0)
    found = tt.fit(only, "eq10", solver=solver, force_weight=1.0, torque_weight=1.0)
    np.testing.assert_allclose(found.field.values, expected.field.values, atol=1e-6)
    with_torques = tt.fit(whole, "eq10", force_weight=1.0, torque_weight=1.0)
    difference = with_torques.field.values - found.field.values
    assert np.abs(difference).max() > 1e-3  # torques would have said something


@pytest.mark.parametrize("name", ["eq10_sign", "robust", "viscous_drag", "tikhonov"])
def test_other_formulations(name):
    _, only = scenes()
    assert tt.fit(only, name).status is tt.Status.SOLVED


def test_the_recursion_and_its_updates():
    whole, only = scenes()
    batch = tt.fit(only, "eq10", force_weight=1.0)
    recursion = tt.RecursiveFit(only, force_weight=1.0, torque_weight=1.0)
    np.testing.assert_allclose(
        recursion.field.values, batch.field.values, atol=1e-7, rtol=0
    )
    first = only.trajectory
    told = recursion.update(first.rotation[0], first.position[0], first.force[0])
    assert told.components == ("fx", "fy", "fz")
    other = tt.RecursiveFit(whole)
    with pytest.raises(InputError, match="torque_weight=0"):
        other.update(first.rotation[0], first.position[0], first.force[0])


def test_evaluation_and_report_say_that_there_are_none():
    whole, only = scenes()
    field = tt.fit(only, "eq10", force_weight=1.0).field
    errors = tt.evaluate(field, only.shell, only.trajectory).errors
    expected = tt.evaluate(field, whole.shell, whole.trajectory).errors
    assert errors.force_magnitude_error_N == expected.force_magnitude_error_N
    assert np.isnan(errors.torque_magnitude_error_Nm)
    assert errors.frames_with_torque == 0
    report = sanity.check_recordings(only, field)
    assert report.mistake is None
    assert "no torques" in report.lines[0]
    assert "forces" in repr(only)


def test_a_flipped_sensor_of_forces_is_told():
    _, only = scenes()
    wrong = with_wrenches(only, -only.f)
    report = sanity.check_recordings(wrong, tt.fit(wrong, "laplace_only").field)
    assert report.mistake.mends == "--flip-wrench"

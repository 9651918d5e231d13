"""Drag of the skin: patches and sliding by hand, rows, recovery and rendering."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import (
    InputError,
    dragged_scene,
    ellipsoid,
    presses,
    refuses,
    small_scene,
    torso,
)
from ttus_opt.contact.contact_size import patch_factors, patches_of
from ttus_opt.contact.friction import DEADBAND, Sliding, pressing_axis, viscous_rows
from ttus_opt.voxmap.sampling import LEAST_LENGTH

TUBE = tt.Surface.from_radius(np.full((72, 21), 0.09), np.linspace(0.0, 0.2, 21))
VOXMAP = tt.Voxmap.from_surface(TUBE, shape=(13, 36, 16), r_inner=0.03)
SHELL = tt.PointShell.sphere(radius=0.015, n_points=800)


def slide(velocity, n=9, spin=None, deep=0.005):
    """A sphere pressed into the tube at θ = 0, moving at a constant velocity [m/s]."""
    time = 0.05 * np.arange(n)
    start = np.array([0.09 + 0.015 - deep, 0.0, 0.1])
    position = start + (time - time.mean())[:, None] * velocity
    turn = np.zeros(3) if spin is None else spin
    rotation = Rotation.from_rotvec(time[:, None] * turn).as_matrix()
    return tt.Trajectory(time, position, rotation)


def test_patches_all_around_a_torso_equal_a_loop_over_points():
    """Leaning probes, and torques about a point beside the probe's centre."""
    surface, shell = torso(), ellipsoid(400, (0.02, 0.015, 0.012))
    shell = replace(shell, reference=np.array([0.004, -0.006, 0.01]))
    voxmap = tt.Voxmap.from_surface(surface, shape=(9, 30, 15))
    trajectory = presses(surface, 15, np.random.default_rng(2), depth=0.02)
    sliding, touching = Sliding.of(voxmap, shell, trajectory), 0
    turning = trajectory.angular_velocity()
    poses = trajectory.rotation, trajectory.position
    factors = patch_factors(patches_of(voxmap, shell, *poses).spread, LEAST_LENGTH)
    for t, moved in enumerate(trajectory.velocity()):
        R, at = trajectory.rotation[t], trajectory.position[t]
        normal, lever = np.zeros(3), np.zeros(3)
        total = square = 0.0
        for point, n, area in zip(
            shell.points, shell.normals, shell.areas, strict=True
        ):
            x, y, z = R @ point + at
            theta = np.arctan2(y, x) % (2.0 * np.pi)
            depth = float(surface.radius_at(theta, z)) - np.hypot(x, y)
            if depth > 0.0 and voxmap.grid.z_min <= z <= voxmap.grid.z_max:
                total += area * depth
                normal += area * depth * (R @ n)
                lever += area * depth * (R @ (point - shell.reference))
                square += area * depth * float(point @ point)
        if total == 0.0:
            assert not sliding.normal[t].any() and not sliding.velocity[t].any()
            continue
        touching += 1
        normal, lever = normal / np.linalg.norm(normal), lever / total
        arm = R @ shell.reference + lever
        length = np.sqrt(0.005**2 + 12.0 * (square / total - arm @ arm))
        assert factors[t] == pytest.approx(0.01 / length, rel=1e-6)
        moved = moved + np.cross(turning[t], arm)
        for found, expected in (
            (sliding.normal, normal),
            (sliding.arm, lever),
            (sliding.position, at + arm),
            (sliding.velocity, moved - normal * (normal @ moved)),
        ):
            np.testing.assert_allclose(found[t], expected, rtol=1e-6, atol=1e-9)
    assert touching > 8


def test_a_spinning_sphere_slides_at_its_patch_only():
    """ω about y at arm −13.5 mm along x moves the patch along z."""
    trajectory = slide(np.zeros(3), spin=np.array([0.0, 1.0, 0.0]))
    patch = Sliding.of(VOXMAP, SHELL, trajectory)
    np.testing.assert_allclose(patch.velocity[:, 2], 0.0135, atol=0.001)
    tool = Sliding.of(VOXMAP, SHELL, trajectory, "reference")
    assert np.abs(tool.velocity).max() < 1e-4
    assert not tool.arm.any()


def test_a_plunge_along_the_probes_own_axis_is_no_sliding():
    """However the probe leans on the skin; without an axis of its own, the mean."""
    lean = np.deg2rad(25.0)
    out = np.array([np.cos(lean), 0.0, np.sin(lean)])
    own = np.stack([np.array([0.0, 1.0, 0.0]), np.cross(out, [0.0, 1.0, 0.0]), out], 1)
    plunge = replace(slide(-0.01 * out), rotation=np.repeat(own[None], 9, axis=0))
    probe = ellipsoid(1500, (0.03, 0.0125, 0.018))
    seen = Sliding.of(VOXMAP, probe, plunge, "reference")
    mean = np.einsum("tij,ti->j", plunge.rotation, seen.normal)
    assert mean[2] / np.linalg.norm(mean) < 0.99  # the mean normal leans
    np.testing.assert_allclose(np.abs(seen.axis), [0.0, 0.0, 1.0], atol=2e-3)
    assert np.abs(seen.velocity).max() < 2e-5
    ball = Sliding.of(VOXMAP, SHELL, plunge, "reference")
    mean = np.einsum("tij,ti->j", plunge.rotation, ball.normal)
    np.testing.assert_allclose(ball.axis, mean / np.linalg.norm(mean), atol=1e-12)


def test_the_axis_of_a_body_of_revolution_lies_in_its_plane():
    disc = tt.PointShell.ellipsoid(semi_axes=(0.01, 0.02, 0.02), n_points=1500)
    normal = np.array([0.3, 0.6, -0.8])
    np.testing.assert_allclose(pressing_axis(disc, normal), [0.0, 0.6, -0.8], atol=5e-3)
    assert not pressing_axis(disc, np.zeros(3)).any()


def test_no_contact_no_sliding():
    sliding = Sliding.of(VOXMAP, SHELL, slide(np.array([0, 0, 0.01]), deep=-0.01))
    for value in (sliding.normal, sliding.velocity, sliding.arm, sliding.axis):
        assert not value.any()


def test_the_deadband_is_a_ramp_to_rest():
    for speed, length in ((0.0, 0.0), (0.5, 0.5), (1.0, 1.0), (4.0, 1.0)):
        trajectory = slide(np.array([0.0, 0.0, speed * DEADBAND]))
        direction = Sliding.of(VOXMAP, SHELL, trajectory).direction()
        np.testing.assert_allclose(
            np.linalg.norm(direction, axis=1), length, rtol=1e-2, atol=1e-9
        )
    with pytest.raises(InputError, match="deadband must be positive"):
        Sliding.of(VOXMAP, SHELL, trajectory).direction(0.0)
    with pytest.raises(InputError, match="acts_at must be one of contact, reference"):
        Sliding.of(VOXMAP, SHELL, trajectory, "handle")


def test_viscous_rows_put_each_pose_into_its_region():
    scene = small_scene()
    sliding = Sliding.of(scene.voxmap, scene.shell, scene.trajectory)
    region = sliding.regions(6, 2, scene.voxmap)
    angle = np.arctan2(sliding.position[:, 1], sliding.position[:, 0]) % (2 * np.pi)
    np.testing.assert_array_equal(region // 2, (angle / (np.pi / 3)).astype(int))
    band = sliding.regions(3, 10, scene.voxmap) % 10  # of 2 cm each
    np.testing.assert_array_equal(band, (sliding.position[:, 2] / 0.02).astype(int))
    assert len(set(band)) > 2
    rows = viscous_rows(sliding, region, 12)
    c = np.arange(12.0)
    drag = (rows.force @ c).reshape(-1, 3)
    np.testing.assert_allclose(drag, c[region][:, None] * sliding.velocity)
    refuses(InputError, "at least one sector", sliding.regions, 0, 2, scene.voxmap)


@pytest.mark.parametrize("acts_at", ["contact", "reference", "points"])
def test_coulomb_global_finds_what_was_put_in(acts_at):
    scene = dragged_scene(acts_at)
    solution = tt.fit(scene, "coulomb_global", force_weight=1e-2, torque_weight=1e-2)
    assert solution.parameters["friction_coefficient"] == pytest.approx(0.3, abs=2e-3)
    assert solution.parameters["drag_at_reference"] == float(acts_at == "reference")
    assert solution.parameters["drag_at_points"] == float(acts_at == "points")
    assert solution.timings.search is not None
    errors = tt.evaluate(solution.field, scene.shell, scene.trajectory).errors
    assert errors.force_angle_error_deg < 0.2
    without = tt.fit(scene, "eq10", force_weight=1e-2, torque_weight=1e-2)
    worse = tt.evaluate(without.field, scene.shell, scene.trajectory).errors
    assert worse.force_angle_error_deg > 8.0


@pytest.mark.slow
def test_the_boundary_scale_is_the_objectives_own():
    """Against dense least squares over (p, s): the scene's own fit is elsewhere."""
    made = dragged_scene("contact", shape=(7, 14, 8))
    lump = made.trajectory.position[:, 2:] > 0.11  # stiffer there, as over a rib
    stiffer = made.trajectory.force * np.where(lump, 3.0, 1.0)
    scene = tt.Scene.assemble(
        made.voxmap,
        made.shell,
        replace(made.trajectory, force=stiffer),
        inner="fit",
        sampling="trilinear",
    )
    solution = tt.fit(scene, "coulomb_global", force_weight=1.0, torque_weight=0.5)
    rows, targets = [], []
    for term in solution.program.terms:
        boundary = -scene.b if term.name == "laplace" else np.zeros(len(term.target))
        block = np.column_stack([term.matrix.toarray(), boundary])
        rows.append(np.sqrt(term.weight) * block)
        target = np.zeros(len(boundary)) if boundary.any() else term.target
        targets.append(np.sqrt(term.weight) * target)
    x, *_ = np.linalg.lstsq(np.vstack(rows), np.concatenate(targets), rcond=None)
    found = solution.parameters["boundary_scale"] / scene.parameters["boundary_scale"]
    assert found == pytest.approx(x[-1], abs=3e-3)
    assert abs(found - 1.0) > 0.02
    given = tt.fit(made, "coulomb_global", force_weight=1.0, torque_weight=0.5)
    assert "boundary_scale" not in given.parameters  # given values stay
    np.testing.assert_array_equal(given.program.term("laplace").target, made.b)


def test_coulomb_drag_field_finds_what_was_put_in():
    scene = dragged_scene("contact", shape=(8, 18, 9))
    solution = tt.fit(scene, "coulomb_drag", force_weight=1.0, torque_weight=1.0)
    assert solution.parameters["friction_coefficient"] == pytest.approx(0.3, rel=1e-3)
    p, q = solution.variables["p"], solution.variables["q"]
    region = scene.voxmap.region.reshape(-1)
    assert (q * region).min() > -1e-5
    assert ((p - q) * region).min() > -1e-5
    assert np.abs(q[region == 0]).max() < 1e-5
    assert solution.parameters["mean_friction_coefficient"] == pytest.approx(0.3)
    assert set(solution.duals_by_name) == {"drag_sign", "drag_limit", "mean_friction"}
    assert solution.duals_by_name["drag_sign"].shape == (scene.n_voxels,)


WEIGHTS = {"force_weight": 1e-2, "torque_weight": 1e-2}


def phantom_scene(folder, kind, shape, n_points):
    """The independent torso with a recording of it, boundary scale fitted."""
    surface = tt.Surface.load(folder / "surface.nc")
    return tt.Scene.assemble(
        tt.Voxmap.from_surface(surface, shape=shape, r_inner=0.03),
        ellipsoid(n_points, (0.03, 0.0125, 0.018)),
        tt.read_trajectory(folder / f"{kind}_fit.csv"),
        inner="fit",
        sampling="trilinear",
    )


def errors_on(field, shell, path):
    """Errors on a recording."""
    return tt.evaluate(field, shell, tt.read_trajectory(path)).errors


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["press", "sweep"])
def test_friction_of_the_independent_phantom(shared, kind):
    """Unseen angles from 12-14° to 3° and less, and nothing lost.

    Against true forces, for sensor noise alone turns a force by 2°. The same contacts
    are there without drag: eq. 10 fitted to those shows what is the field's, to which
    drag adds next to nothing.
    """
    folder, without = shared / "phantom", shared / "phantom_frictionless"
    scene = phantom_scene(folder, kind, (48, 120, 60), 1500)
    plain = tt.fit(scene, "eq10", **WEIGHTS).field
    solution = tt.fit(scene, "coulomb_global", **WEIGHTS)
    assert solution.parameters["friction_coefficient"] == pytest.approx(0.25, rel=0.1)
    axis = np.abs([solution.parameters[f"drag_axis_{a}"] for a in "xyz"])
    np.testing.assert_allclose(axis, [0.0, 0.0, 1.0], atol=1e-3)
    smooth = phantom_scene(without, kind, (48, 120, 60), 1500)
    ideal = tt.fit(smooth, "eq10", **WEIGHTS).field
    for name in ("press_test", "sweep_test"):
        before, after = (
            errors_on(field, scene.shell, folder / f"{name}.csv")
            for field in (plain, solution.field)
        )
        true = errors_on(solution.field, scene.shell, folder / f"{name}_truth.csv")
        bare = errors_on(ideal, scene.shell, without / f"{name}_truth.csv")
        assert before.force_angle_error_deg > 12.0
        # 2.29° at worst, and 1.34° beside 0.77° without any drag
        assert true.force_angle_error_deg < min(2.5, bare.force_angle_error_deg + 0.6)
        assert after.force_magnitude_error_N < before.force_magnitude_error_N
        # 0.006 N at worst, a sixtieth of what a hand can tell
        assert true.force_magnitude_error_N < bare.force_magnitude_error_N + 0.01
        assert after.torque_magnitude_error_Nm < before.torque_magnitude_error_Nm * 1.03
        assert true.torque_magnitude_error_Nm < bare.torque_magnitude_error_Nm * 1.03

"""N and W against a brute-force loop in plain numpy."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import InputError, ellipsoid, presses, refuses, small_scene, torso
from ttus_opt.contact.rows import PoseRows, contact_rows
from ttus_opt.probe.cylindrical import cylindrical

SURFACE = torso()
VOXMAP = tt.Voxmap.from_surface(SURFACE, shape=(24, 40, 21))
SHELL = ellipsoid(400, (0.02, 0.015, 0.012))
RNG = np.random.default_rng(3)
POSES = presses(SURFACE, 8, RNG, depth=0.02)
FIELD = RNG.normal(size=VOXMAP.grid.shape)


def skin_at(j, k):
    """Radius of the skin on a spoke."""
    return float(SURFACE.radius_at(VOXMAP.grid.theta[j], VOXMAP.grid.z[k]))


def below_the_skins_layer(j, k):
    """Layers of a spoke up to, not including, the one nearest to the skin."""
    return np.arange(np.abs(VOXMAP.grid.r - skin_at(j, k)).argmin())


def between_spokes(theta, z, depth):
    """Bilinear between spokes, each a polyline that ends with 0 at the skin."""
    grid, total = VOXMAP.grid, 0.0
    for j in range(grid.shape[1]):
        turn = (theta - grid.theta[j] + np.pi) % (2 * np.pi) - np.pi
        around = max(0.0, 1.0 - abs(turn) / grid.theta_step)
        for k in np.flatnonzero(np.abs(z - grid.z) < grid.z_step) if around else ():
            layers, skin = below_the_skins_layer(j, k), skin_at(j, k)
            radii, values = [*grid.r[layers], skin], [*FIELD[layers, j, k], 0.0]
            along = 1.0 - abs(z - grid.z[k]) / grid.z_step
            total += around * along * np.interp(skin - depth, radii, values)
    return total


def nearest(r, theta, z, depth):
    """Flat index of the nearest voxel, -1 before the skin layer's inner face."""
    grid = VOXMAP.grid
    i = int(np.abs(r - grid.r).argmin())
    turn = (theta - grid.theta + np.pi) % (2 * np.pi) - np.pi
    j, k = int(np.abs(turn).argmin()), int(np.abs(z - grid.z).argmin())
    last = below_the_skins_layer(j, k)[-1]
    face = grid.r[last] + grid.r_step / 2
    if i > last or skin_at(j, k) - depth >= face:
        return -1
    return int(np.ravel_multi_index((i, j, k), grid.shape))


def brute_force(rotation, position, sampling):
    """Force and torque of one pose, point by point."""
    grid = VOXMAP.grid
    lever = SHELL.points @ rotation.T - SHELL.reference @ rotation.T
    points = SHELL.points @ rotation.T + position
    normals = SHELL.normals @ rotation.T
    r, theta, z = cylindrical(points)
    depth = SURFACE.radius_at(theta, z) - r
    inside = (depth > 0) & (z >= grid.z_min) & (z <= grid.z_max)
    moments = np.cross(lever, normals)
    weight = np.zeros(len(points))
    if sampling == "trilinear":
        for m in np.flatnonzero(inside):
            weight[m] = between_spokes(theta[m], z[m], depth[m]) * SHELL.areas[m] / 1e-4
        return weight @ normals, weight @ moments
    voxel = np.full(len(points), -1)
    for m in np.flatnonzero(inside):
        voxel[m] = nearest(r[m], theta[m], z[m], depth[m])
    for v in np.unique(voxel[voxel >= 0]):
        weight[voxel == v] = FIELD.reshape(-1)[v] / (voxel == v).sum()
    return weight @ normals, weight @ moments


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
def test_rows_equal_brute_force(sampling):
    rows = contact_rows(
        VOXMAP, SHELL, POSES.rotation, POSES.position, sampling=sampling
    )
    assert (rows.contact_points > 0).sum() > 4
    force = (rows.N @ FIELD.reshape(-1)).reshape(-1, 3)
    torque = (rows.W @ FIELD.reshape(-1)).reshape(-1, 3)
    for t in range(len(POSES)):
        f, tau = brute_force(POSES.rotation[t], POSES.position[t], sampling)
        np.testing.assert_allclose(force[t], f, atol=1e-11)
        np.testing.assert_allclose(torque[t], tau, atol=1e-12)


def test_the_reference_point_is_where_torque_is_about():
    reference = np.array([0.01, -0.02, 0.005])
    moved = tt.PointShell(SHELL.points, SHELL.normals, SHELL.areas, reference)
    p = FIELD.reshape(-1)
    a = contact_rows(VOXMAP, SHELL, POSES.rotation, POSES.position)
    b = contact_rows(VOXMAP, moved, POSES.rotation, POSES.position)
    force = (a.N @ p).reshape(-1, 3)
    shift = (moved.reference - SHELL.reference) @ np.swapaxes(POSES.rotation, 1, 2)
    expected = (a.W @ p).reshape(-1, 3) - np.cross(shift, force)
    np.testing.assert_allclose((b.W @ p).reshape(-1, 3), expected, atol=1e-12)


def test_force_of_a_constant_field_on_a_submerged_probe_vanishes():
    """Closed surface: Σ a n̂ = 0, so a constant pressure pushes nowhere."""
    rotation = Rotation.random(5, rng=np.random.default_rng(0)).as_matrix()
    position = np.tile([0.0, 0.06, 0.1], (5, 1))
    rows = contact_rows(VOXMAP, SHELL, rotation, position, sampling="trilinear")
    assert (rows.contact_points == len(SHELL.points)).all()
    force = rows.N @ np.ones(VOXMAP.grid.n_voxels)
    assert np.abs(force).max() < 0.01 * SHELL.areas.sum() / 1e-4


def test_a_linear_pressure_lifts_like_archimedes():
    """p = x [N/cm²] on a submerged probe: force = -∫ p n_out = -volume·∂p/∂x."""
    grid = VOXMAP.grid
    fine = tt.Voxmap.from_surface(SURFACE, shape=(60, 200, 21))
    grid = fine.grid
    x = grid.r[:, None, None] * np.cos(grid.theta)[None, :, None]
    p = np.broadcast_to(x, grid.shape).reshape(-1) * 1e4  # N/cm² per m → N/m² per m
    shell = tt.PointShell.ellipsoid(semi_axes=(0.02, 0.015, 0.012), n_points=1200)
    rows = contact_rows(
        fine, shell, np.eye(3)[None], np.array([[0.0, 0.06, 0.1]]), sampling="trilinear"
    )
    volume = 4 / 3 * np.pi * 0.02 * 0.015 * 0.012
    force = rows.N @ (p * 1e-4)  # the field is in N/cm²
    np.testing.assert_allclose(force, [-volume * 1e4, 0, 0], atol=0.02 * volume * 1e4)


def test_pose_off_the_grid_gives_zero_and_says_so():
    position = np.array([[0.0, 0.1, 5.0], [0.0, 0.09, 0.1], [3.0, 0.0, 0.1]])
    rows = contact_rows(VOXMAP, SHELL, np.tile(np.eye(3), (3, 1, 1)), position)
    assert rows.in_grid.tolist() == [False, True, False]
    assert rows.N[:3].nnz == rows.N[6:].nnz == 0
    n_voxels = f"{VOXMAP.grid.n_voxels:,}"
    assert repr(rows) == f"ContactRows(3 poses, 1 in contact, {n_voxels} voxels)"


def test_trilinear_rows_are_continuous_in_the_pose_and_voxel_means_jump():
    steps = np.linspace(0.0, 0.004, 2001)
    position = np.tile([0.0, 0.094, 0.1], (len(steps), 1))
    position[:, 2] += steps
    rotation = np.tile(np.eye(3), (len(steps), 1, 1))
    z = np.broadcast_to(VOXMAP.grid.z, VOXMAP.grid.shape).reshape(-1)
    jumps = {}
    for sampling in ("trilinear", "voxel-mean"):
        rows = contact_rows(VOXMAP, SHELL, rotation, position, sampling=sampling)
        force = (rows.N @ z).reshape(-1, 3)[:, 1]
        jumps[sampling] = np.abs(np.diff(force)).max() / np.abs(force).mean()
    assert jumps["trilinear"] < 0.2 * jumps["voxel-mean"]


@pytest.mark.parametrize(
    ("rotation", "position", "word"),
    [
        (np.eye(3), np.zeros((1, 3)), r"\(1, 3, 3\)"),
        (np.eye(3)[None], np.zeros(3), r"\(T, 3\)"),
        (np.eye(3)[None], np.zeros((1, 3, 1)), r"\(T, 3\)"),
        (np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 4)), r"\(T, 3\)"),
        (np.tile(np.eye(3), (3, 1, 1)), np.zeros((3, 2)), r"\(T, 3\)"),
        (2 * np.eye(3)[None], np.zeros((1, 3)), "orthonormal"),
        (1.00001 * np.eye(3)[None], np.zeros((1, 3)), "orthonormal"),
        (np.eye(3)[None], np.full((1, 3), np.nan), "NaN"),
    ],
)
def test_unusable_poses(rotation, position, word):
    refuses(InputError, word, contact_rows, VOXMAP, SHELL, rotation, position)


def test_a_rotation_read_from_a_file_is_precise_enough():
    """Quaternions with seven digits, as files carry them."""
    exact = Rotation.from_matrix(POSES.rotation)
    rotation = Rotation.from_quat(exact.as_quat().round(7)).as_matrix().round(7)
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max()
    assert off > 1e-8  # not quite orthonormal
    found = contact_rows(VOXMAP, SHELL, rotation, POSES.position)
    expected = contact_rows(VOXMAP, SHELL, POSES.rotation, POSES.position)
    np.testing.assert_array_equal(found.contact_points, expected.contact_points)
    assert abs(found.N - expected.N).max() < 1e-3 * abs(expected.N).max()


def test_unknown_sampling():
    with pytest.raises(InputError, match="voxel-mean, trilinear"):
        contact_rows(VOXMAP, SHELL, POSES.rotation, POSES.position, sampling="mean")


@pytest.mark.parametrize("sampling", ["trilinear", "contact-size"])
def test_rows_at_the_recorded_poses_are_those_of_contact(sampling):
    scene = small_scene(sampling)
    own = scene.trajectory
    rows = PoseRows(scene.voxmap, scene.shell, sampling)
    assert abs(rows.at(own.rotation, own.position) - scene.N).max() < 1e-14


def test_derivatives_are_those_of_the_force():
    """By a step a hundred times smaller, for a field without corners."""
    scene = small_scene("trilinear", (9, 20, 10), 12)
    own = scene.trajectory
    rows = PoseRows(scene.voxmap, scene.shell, "trilinear")
    p = scene.laplace.solve(scene.b)
    noise, fine = tt.TrackerNoise(1e-4, 2e-3), tt.TrackerNoise(1e-6, 2e-5)
    found = rows.derivatives(own.rotation, own.position, noise)
    assert len(found) == 6
    for j in range(6):
        xi = np.zeros((len(own), 6))
        xi[:, j] = 1.0
        ahead = rows.at(*fine.moved(own.rotation, own.position, xi)) @ p
        expected = 100.0 * (ahead - rows.at(own.rotation, own.position) @ p)
        error = np.linalg.norm(found[j] @ p - expected)
        assert error < 0.05 * np.linalg.norm(expected)

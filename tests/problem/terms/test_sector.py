"""Over a sector of θ nothing reaches through its sides or into its wall."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import ellipsoid, presses, torso
from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import TtusWarning
from ttus_opt.gaussian.matern import SeparableCovariance
from ttus_opt.problem.terms.departures import difference_rows
from ttus_opt.problem.terms.laplace import LaplaceFreeSurfaceTerm
from ttus_opt.voxmap.voxmap import Voxmap


@pytest.fixture(scope="module")
def scene():
    """Presses in a sector of 150° around the front, two of them across its sides."""
    sector = (np.radians(15.0), np.radians(165.0))
    voxmap = Voxmap.from_surface(torso(), shape=(9, 12, 8), sector=sector)
    poses = presses(torso(), 12, np.random.default_rng(0))
    with pytest.warns(TtusWarning, match="2 of 12 poses touch .* beyond the grid's"):
        return Scene.assemble(
            voxmap, ellipsoid(), poses, inner=2.0, outer=1.5, sampling="trilinear"
        )


def test_the_fit_is_that_of_dense_algebra(scene):
    solution = tt.fit(scene, "eq10", force_weight=0.5, torque_weight=0.2)
    scale = np.sqrt(0.5), np.sqrt(0.2) / scene.torque_length
    parts = (scene.L, scale[0] * scene.N, scale[1] * scene.W)
    rows = np.concatenate([np.asarray(part.toarray()) for part in parts])
    target = np.concatenate([scene.b, scale[0] * scene.f, scale[1] * scene.tau])
    p = scene.voxmap.grid.unflatten(np.linalg.solve(rows.T @ rows, rows.T @ target))
    np.testing.assert_allclose(solution.field.values, p, rtol=0, atol=1e-6)
    assert np.abs(p[:, -1]).max() < 1e-9


def test_a_press_on_the_front_is_fitted_as_on_the_full_turn():
    """Presses within 40° of the middle of a sector of 165° do not feel its sides."""
    poses = presses(torso(), 30, np.random.default_rng(1))
    angle = np.arctan2(poses.position[:, 1], poses.position[:, 0])
    front = poses.select(np.abs(angle - 0.5 * np.pi) < np.radians(40.0))
    told, unseen = front.select(slice(0, None, 2)), front.select(slice(1, None, 2))
    forces = []
    for n, sector in ((24, None), (12, (np.radians(7.5), np.radians(172.5)))):
        voxmap = Voxmap.from_surface(
            torso(), shape=(10, n, 9), r_outer=0.15, sector=sector
        )
        scene = Scene.assemble(voxmap, ellipsoid(), told, inner=2.0, outer=1.5)
        field = tt.fit(scene, "eq10", force_weight=1.0, torque_weight=1.0).field
        forces.append(tt.evaluate(field, ellipsoid(), unseen).rendered_force)
    whole, part = forces
    np.testing.assert_allclose(part, whole, rtol=0, atol=0.01 * np.abs(whole).max())
    assert np.abs(part - whole).max() > 0.0


def test_differences_stay_within_the_sector(scene):
    grid = scene.voxmap.grid
    D = difference_rows(grid)
    angle = np.broadcast_to(np.arange(12.0)[:, None], grid.shape).copy()
    angle[:, -1] = 0.0
    slopes = (D @ angle.reshape(-1)).reshape(*grid.shape, 3)
    arc = grid.r_step / (grid.r * grid.theta_step)
    expected = np.broadcast_to(arc[:, None, None], (9, 10, 8))
    np.testing.assert_allclose(slopes[:, :10, :, 1], expected)
    assert (slopes[:, 10:, :, 1] == 0.0).all()
    assert (slopes[..., [0, 2]] == 0.0).all()


def test_a_free_surface_keeps_the_wall(scene):
    rows = LaplaceFreeSurfaceTerm(scene, 1.0, skin=0.0).rows().blocks["p"]
    wall = np.arange(scene.n_voxels).reshape(scene.voxmap.grid.shape)[:, -1].ravel()
    assert (rows[wall] != scene.L[wall]).nnz == 0
    dropped = np.flatnonzero(np.diff(rows.indptr) == 0)
    assert len(dropped)
    assert not np.isin(dropped, wall).any()


def test_a_depth_map_is_correlated_within_the_sector_alone(scene):
    """The first spokes know of the next ones as inside, of the last ones nothing."""
    n_z = scene.voxmap.grid.shape[2]
    prior = SeparableCovariance.over(
        scene.voxmap, np.ones(scene.n_voxels), surface_length=0.05, depth_length=0.015
    )
    first = prior.surface.covariance(np.array([n_z // 2]))[:, 0].reshape(12, n_z)
    assert (np.abs(first[-1]) < 1e-12).all()
    around = first[:, n_z // 2]
    assert (np.diff(around[:-1]) < 0.0).all()
    assert around[10] < 0.01 * around[0]

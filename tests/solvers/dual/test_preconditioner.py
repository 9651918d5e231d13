"""The approximate Schur complement against the exact one, written down as matrices."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from tests.kit import small_scene
from ttus_opt.problem import formulation
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.preconditioner import ApproximateSchur, SchurPreconditioner


def dual_system(sampling, weight, name="eq10"):
    scene = small_scene(sampling, (12, 24, 16), n_poses=6)
    program = formulation.load(
        name, scene, force_weight=weight, torque_weight=weight
    ).compile()
    return DualData.of(program).system


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eq10", "eq10_hard_boundary"])
@pytest.mark.parametrize("sampling", ["trilinear", "voxel-mean"])
def test_is_spectrally_equivalent_at_light_and_heavy_weights(sampling, name):
    """Ratios of S̃ to S stay in one band, whatever the weight."""
    for weight in (1e-4, 1.0, 1e2):
        system = dual_system(sampling, weight, name)
        unit = np.eye(len(system.root_weights))
        exact = np.array([system.apply(e) for e in unit])
        tilde = np.array([ApproximateSchur(system).apply(e) for e in unit])
        assert np.abs(tilde - tilde.T).max() < 1e-5 * np.abs(tilde).max()
        ratios = scipy.linalg.eigh((tilde + tilde.T) / 2, exact, eigvals_only=True)
        assert 0.4 < ratios.min() <= ratios.max() < 1.3


@pytest.mark.slow
@pytest.mark.parametrize("name", ["eq10", "eq10_hard_boundary"])
def test_a_box_of_the_grid_is_enough(name):
    """Every voxel of a press measured: nearly the same band, at a part of the cost."""
    scene = small_scene("trilinear", (24, 64, 32), n_poses=1)
    program = formulation.load(name, scene).compile()
    system = DualData.of(program).system
    touched = np.unique(system.rows.indices)
    rows = sp.csr_array(sp.eye_array(scene.voxmap.grid.n_voxels, format="csr")[touched])
    part = scene.laplace.multigrid.preconditioner(touched[scene.laplace.free[touched]])
    assert part.free.sum() < 0.6 * scene.laplace.free.sum()
    for weight in (1e-2, 1e2):
        system = replace(system, rows=rows, root_weights=np.full(len(touched), weight))
        unit = np.eye(len(touched))
        exact = np.array([system.apply(e, 1e-8) for e in unit])
        operator = ApproximateSchur(system)
        tilde = np.array([operator.apply(e) for e in unit])
        ratios = scipy.linalg.eigh((tilde + tilde.T) / 2, exact, eigvals_only=True)
        assert 0.3 < ratios.min() <= ratios.max() < 1.3


def test_at_heavy_weights_it_is_positive_definite():
    """Whatever is kept of earlier calls."""
    system = dual_system("voxel-mean", 1e5)
    precondition = SchurPreconditioner(system)
    for residual in np.random.default_rng(0).normal(size=(9, len(system.root_weights))):
        answer = precondition(residual)
        assert np.isfinite(answer).all()
        assert answer @ residual > 0.0

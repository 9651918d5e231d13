"""Sizes of a program against counts by hand; estimates grow with what they count."""

import numpy as np
import pytest

from tests.kit import small_scene
from ttus_opt.problem.formulation import load
from ttus_opt.problem.reduction import reduce
from ttus_opt.solvers.sizes import Sizes

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)
V = SCENE.n_voxels


def test_eq10_has_rows_alone():
    sizes = Sizes.of(load("eq10", SCENE).compile())
    measured = 2 * 3 * len(SCENE.trajectory)
    assert sizes == Sizes(V, V, V + measured, measured, 0, 0, 0.0)


def test_limits_are_inequalities_and_bounds_alone():
    program = load("eq10_sign_monotone", SCENE).compile()
    rows = sum(len(c.lower) for c in program.constraints)
    bounded = np.isfinite(program.box).any(axis=0).sum()
    sizes = Sizes.of(program)
    assert bounded and sizes.limits == rows + bounded
    assert sizes.width == pytest.approx(2.0)  # a voxel and the next one outwards
    hard = Sizes.of(load("eq10_hard_boundary", SCENE).compile())
    assert hard.limits == 0


def test_a_second_field_and_kinks_are_counted():
    assert Sizes.of(load("coulomb_drag", SCENE).compile()).voxels == 2 * V
    sparse = reduce(load("sparse_sources", SCENE).compile()).program
    assert Sizes.of(sparse).kinks > 0

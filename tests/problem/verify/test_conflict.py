"""Constraints that contradict each other are found by name."""

from dataclasses import dataclass

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.problem.constraints.base import Bounds, Constraint
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.monotone import Monotone
from ttus_opt.problem.constraints.sign import Sign
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.verify.conflict import conflicting

SCENE = small_scene("trilinear", shape=(7, 12, 8), n_poses=4)


@dataclass(frozen=True)
class Band(Constraint):
    """Bounds on every voxel."""

    low: float = -np.inf
    high: float = np.inf

    name = "band"
    formula = "low ≤ p ≤ high"

    def rows(self):
        V = self.scene.n_voxels
        return Bounds("p", np.full(V, self.low), np.full(V, self.high))


def names(*constraints):
    return conflicting(Program.build(SCENE, [LaplaceTerm(SCENE)], constraints))


def test_constraints_that_can_hold_are_not_accused():
    assert names() == ()
    assert names(Sign(SCENE)) == ()
    assert names(Sign(SCENE), Monotone(SCENE), HardBoundary(SCENE)) == ()


def test_a_least_slope_against_the_boundary():
    """2 N at the inner layer cannot fall by 1000 N/m over 6 cm; sign is innocent."""
    steep = Monotone(SCENE, 1000.0)
    assert names(Sign(SCENE), steep, HardBoundary(SCENE)) == ("monotone", "boundary")
    assert names(Sign(SCENE), steep) == ()  # soft boundary values give way


def test_a_least_slope_against_bounds():
    assert names(Monotone(SCENE, 1000.0), Band(SCENE, 0.0, 5.0)) == ("monotone", "band")


def test_bounds_that_cross():
    assert names(Sign(SCENE), Band(SCENE, low=1.0)) == ("sign", "band")


@pytest.mark.parametrize("slope", [10.0, 20.0])
def test_a_slope_the_boundary_allows(slope):
    assert names(Monotone(SCENE, slope), HardBoundary(SCENE)) == ()

"""The objective over the field alone: its value, its slope, and what bounds its gap."""

import functools
from typing import NamedTuple

import numpy as np
import pytest

from tests.kit import small_scene
from tests.oracles.dense import minimiser
from ttus_opt.problem.formulation import load
from ttus_opt.problem.program import Program
from ttus_opt.solvers.dual.linear_parameters import Complement
from ttus_opt.solvers.primal.least_squares import LeastSquares
from ttus_opt.solvers.primal.split import Split, wide_terms

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)
FEW = 50


class Made(NamedTuple):
    program: Program
    split: Split
    function: LeastSquares


@functools.cache
def made():
    weights = {"force_weight": 0.3, "torque_weight": 0.1}
    program = load("tikhonov", SCENE, ridge=1e-2, **weights).compile()
    split = Split.of(program, FEW)
    none = Complement(np.zeros((len(split.few.t), 0)), lambda residual: residual)
    return Made(program, split, LeastSquares(split, none))


def random_field(seed):
    return np.random.default_rng(seed).normal(size=SCENE.n_voxels)


def test_a_program_is_parted_into_prior_wide_and_few():
    program, split, _ = made()
    assert [term.name for term in wide_terms(program, FEW)] == ["tikhonov"]
    assert not wide_terms(program, 10**6)
    assert split.prior.weight == 1.0
    prior = next(t for t in program.terms if t.laplace_rows is not None)
    assert split.wide[0].weight == pytest.approx(1e-2 / prior.weight)
    rows = sum(len(t.target) for t in program.terms if t.is_measured)
    assert len(split.few.t) == rows
    assert split.moving.all()
    assert not split.given.any()


def test_its_value_is_the_programs_objective():
    program, _, function = made()
    prior = next(t for t in program.terms if t.laplace_rows is not None)
    for seed in range(3):
        p = random_field(seed)
        whole = program.objective(p) / prior.weight
        assert function.value(p) == pytest.approx(whole, rel=1e-10)


def test_both_equations_hold_at_the_minimiser_and_nowhere_else():
    program, _, function = made()
    best = minimiser(program)
    rest = function.residual(np.r_[best, function.misfit(best)])
    other = random_field(0)
    wrong = function.residual(np.r_[other, function.misfit(other)])
    assert np.abs(function.field(rest)).max() < 1e-9 * np.abs(wrong).max()
    assert np.abs(rest[len(best) :]).max() < 1e-12
    slope = function.gradient(wrong)  # minus half of it, against differences
    along, step = random_field(1), 1e-4
    change = function.value(other + step * along) - function.value(other - step * along)
    assert change / (2.0 * step) == pytest.approx(-2.0 * slope @ along, rel=1e-6)


def test_the_gap_is_bounded():
    program, _, function = made()
    best = minimiser(program)
    least = function.value(best)
    for size in (1e-3, 1.0):
        p = best + size * random_field(5)
        gap = function.value(p) - least
        bound = function.gap_bound(np.r_[p, function.misfit(p)])
        assert gap <= 1.05 * bound

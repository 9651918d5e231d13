"""A split program has the objective of the whole one, over the prior's weight."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import small_scene
from tests.solvers.own_terms import AlongZ, DepthWeighted
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.primal.split import Split, wide_terms

SCENE = small_scene("trilinear", shape=(6, 8, 6), n_poses=3)

#: Terms of more rows are wide; the force has three a frame
FEW = 100

CASES = ["eq10", "free_surface", "coulomb_global"]


def made(name, prior=2.5):
    weights = {"force_weight": 0.3, "torque_weight": 0.1}
    whole = load(name, SCENE, **weights) + AlongZ(SCENE, 3.0)
    program = (whole + replace(DepthWeighted(SCENE), weight=0.0)).compile()
    first = program.laplace_prior
    terms = (t.with_weight(prior) if t is first else t for t in program.terms)
    return replace(program, terms=tuple(terms))


@pytest.mark.parametrize("name", CASES)
def test_the_parts_add_up_to_the_objective(name):
    program, rng = made(name), np.random.default_rng(0)
    split = Split.of(program, FEW)
    few, V = split.few, len(split.few.b)
    for _ in range(3):
        x = rng.normal(size=program.n_variables)
        p, c = x[:V], x[V:]
        parts = split.prior.cost(p) + sum(term.cost(p) for term in split.wide)
        rows = few.system.measure(p) + few.columns @ c - few.t
        assert (parts + rows @ rows) * 2.5 == pytest.approx(program.objective(x))


def test_terms_are_sorted_by_their_rows_and_weights():
    program = made("eq10")
    split = Split.of(program, FEW)
    assert split.prior.weight == 1.0
    assert [(t.name, t.weight) for t in split.wide] == [("along_z", 3.0 / 2.5)]
    assert len(split.few.t) == 6 * len(SCENE.trajectory)
    names = [t.name for t in wide_terms(program, FEW)]
    assert names == ["along_z", "depth_weighted"]
    assert wide_terms(program, 10**6) == []
    # measurements are few however many they are
    assert {"force", "torque"}.isdisjoint(t.name for t in wide_terms(program, 0))


def test_its_operator_and_given_values_are_the_program_s():
    split = Split.of(made("eq10"), FEW)
    np.testing.assert_array_equal(split.operator.L.toarray(), SCENE.laplace.L.toarray())
    np.testing.assert_array_equal(split.given, np.where(split.moving, 0.0, SCENE.b))

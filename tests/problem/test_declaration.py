"""Formulations: declaring and combining them, and what cannot be one."""

import pickle
from dataclasses import replace

import pytest

from tests.kit import InputError, refuses, small_scene
from ttus_opt.problem.constraints.boundary import HardBoundary
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.formulation import Formulation, Search, load
from ttus_opt.problem.terms.laplace import LaplaceTerm, SparseSourcesTerm
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm

SCENE = small_scene(shape=(6, 10, 6), n_poses=5)
EQ10 = Formulation([LaplaceTerm(SCENE), ForceTerm(SCENE, 0.1)], name="mine")


def test_repr_is_the_mathematics_with_sizes_and_weights():
    text = str(EQ10.with_constraints(Sign(SCENE), HardBoundary(SCENE)))
    fixed = int(SCENE.voxmap.dirichlet.sum())
    assert text.splitlines() == [
        "mine: minimise over p in R^360",
        "  + 1 · ‖L p − b‖²    [laplace: 360 rows]",
        "  + 0.1 · ‖N p − f‖²    [force: 15 rows]",
        "  subject to p ≥ 0 inside, p ≤ 0 outside    [sign: "
        f"{int((SCENE.voxmap.region != 0).sum())} bounds]",
        "  subject to p = b on inner, outer and surface layer and both ends    "
        f"[boundary: {fixed} rows]",
    ]


def test_repr_of_a_search_and_of_more_variables():
    text = str(load("coulomb_global", SCENE))
    assert "searching friction_coefficient in [0, 1]" in text
    assert "p in R^360, q in R^360" in str(load("coulomb_drag", SCENE))


def test_plus_adds_a_term_and_leaves_the_first_alone():
    first = EQ10
    both = first + TorqueTerm(SCENE, 0.2) + SparseSourcesTerm(SCENE, 0.3)
    names = [term.name for term in both.terms]
    assert names == ["laplace", "force", "torque", "sparse_sources"]
    assert len(first.terms) == 2
    assert both.name == "mine"


def test_weights_change_without_reassembly():
    first = EQ10
    program = first.compile()
    second = first.with_weights(force=5.0)
    again = second.compile()
    assert [t.weight for t in second.terms] == [1.0, 5.0]
    for old, new in zip(program.terms, again.terms, strict=True):
        assert new.matrix is old.matrix
        assert new.target is old.target
    with pytest.raises(InputError, match="no term 'forse', there are laplace, force"):
        first.with_weights(forse=1.0)
    with pytest.raises(InputError, match="force weight must not be negative"):
        first.with_weights(force=-1.0)


def test_a_variants_rows_are_assembled_once():
    first = load("screened", SCENE, screening=20.0)
    first.compile()
    heavier = first.with_weights(screened=3.0)
    assert heavier.terms[0].assembled is first.terms[0].assembled


def test_combining_reaches_into_a_search():
    declared = (
        load("coulomb_global", SCENE).with_weights(force=7.0) + SparseSourcesTerm(SCENE)
    ).with_constraints(Sign(SCENE))
    built = declared.search.build(0.4)
    assert [t.name for t in built.terms][-1] == "sparse_sources"
    assert built.terms[1].weight == 7.0
    assert built.constraints[0].name == "sign"


def test_combining_reaches_into_the_search_after_a_search():
    fitted = replace(SCENE, parameters={"boundary_scale": 2.0})
    declared = load("coulomb_global", fitted).with_weights(force=7.0)
    declared = declared.with_constraints(Sign(fitted))
    found = declared.search.build(0.4)
    assert found.search.parameter == "boundary_scale"
    built = found.search.build(1.5)
    assert built.search is None
    assert built.parameters({})["boundary_scale"] == 3.0
    assert built.parameters({})["friction_coefficient"] == 0.4
    assert built.terms[1].weight == 7.0
    assert built.constraints[0].name == "sign"
    # without forces nothing tells the scale, and a given one stays
    for unknown in (
        load("coulomb_global", fitted, force_weight=0.0),
        load("coulomb_global", SCENE),
    ):
        assert unknown.search.build(0.4).search is None


@pytest.mark.parametrize("limits", [(0.0, 0.0), (1.0, 0.0), (0.0, float("inf"))])
def test_a_search_needs_a_range(limits):
    with pytest.raises(InputError, match="needs a range low < high"):
        Search("mu", *limits, lambda value: EQ10)


def test_what_cannot_be_a_formulation():
    refuses(InputError, "at least one term", Formulation, [])
    refuses(InputError, "force appears twice", lambda: EQ10 + ForceTerm(SCENE))
    with pytest.raises(InputError, match="sign appears twice"):
        EQ10.with_constraints(Sign(SCENE), Sign(SCENE))
    other = replace(SCENE)
    refuses(InputError, "the same scene", lambda: EQ10 + TorqueTerm(other))


def test_members_are_left_out_by_name():
    both = EQ10.with_constraints(Sign(SCENE))
    left = both.without("force", "sign")
    assert [term.name for term in left.terms] == ["laplace"]
    assert not left.constraints
    with pytest.raises(InputError, match=r"no term or constraint 'sing'.*mean sign"):
        both.without("sing")


def test_every_change_of_a_search_is_pickled():
    rows = SparseSourcesTerm(SCENE, 0.3)
    changed = load("coulomb_global", SCENE) + rows
    changed = changed.with_constraints(Sign(SCENE)).with_neutral({"none": "of it"})
    copied = pickle.loads(pickle.dumps(changed.without("torque")))
    built = copied.search.build(0.5)
    assert built.terms[1].drag.coefficient == 0.5
    named = [one.name for one in (*built.terms, *built.constraints)]
    assert named == ["laplace", "force", "sparse_sources", "sign"]

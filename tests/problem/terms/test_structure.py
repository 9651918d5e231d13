"""Solvers go by what members declare, never by a name or by comparing entries."""

from dataclasses import dataclass, field

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import InputError, small_scene
from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.structure import LaplaceRows, Tag, Tags
from ttus_opt.solvers.dual.data import second_field
from ttus_opt.solvers.registry import solvers

SCENE = small_scene("trilinear", shape=(7, 12, 8), n_poses=8)


@dataclass(frozen=True)
class Own(tt.Term):
    """A user's rows, called and tagged as a user likes."""

    called: str = "laplace"
    share: float = 1.0
    tags: Tags = frozenset()

    @property
    def name(self):
        return self.called

    def rows(self):
        scale = np.ones(self.scene.n_voxels)
        scale[::3] = self.share
        rows = sp.csr_array(sp.diags_array(scale) @ self.scene.L)
        return tt.AffineRows({"p": rows}, scale * self.scene.b, self.tags)


@dataclass(frozen=True)
class Given(tt.constraints.Constraint):
    """A user's values at a few voxels."""

    at: Array = field(repr=False)
    name = "boundary"

    def rows(self):
        V, m = self.scene.n_voxels, len(self.at)
        rows = sp.csr_array((np.ones(m), self.at, np.arange(m + 1)), shape=(m, V))
        return tt.terms.LinearRows({"p": rows}, np.full(m, 0.3), np.full(m, 0.3))


def test_a_term_called_laplace_with_other_rows_is_solved_like_any_other():
    """Read by its name, `structured` would answer another problem."""
    declared = tt.Formulation([Own(SCENE, share=0.1), tt.terms.ForceTerm(SCENE, 1.0)])
    program = declared.compile()
    assert program.laplace_term is None
    for name in ("structured", "amg_pcg"):
        assert "Laplace term" in solvers()[name].refusal(program)
    expected = tt.fit(SCENE, declared, solver="closed_form")
    found = tt.fit(SCENE, declared)
    assert found.solver != "structured"
    assert found.status is tt.Status.SOLVED
    assert not found.attempts
    np.testing.assert_allclose(found.field.values, expected.field.values, atol=1e-5)


def test_it_is_one_row_more_beside_the_prior():
    """With a Laplace term of another name beside, `structured` takes both."""
    prior = Own(SCENE, called="mine", tags=frozenset({LaplaceRows("p")}))
    declared = tt.Formulation(
        [Own(SCENE, 0.5, share=0.1), prior, tt.terms.ForceTerm(SCENE, 1.0)]
    )
    term = declared.compile().laplace_term
    assert term.name == "mine"
    expected = tt.fit(SCENE, declared, solver="closed_form")
    found = tt.fit(SCENE, declared, solver="structured")
    np.testing.assert_allclose(found.field.values, expected.field.values, atol=1e-6)


def test_a_constraint_called_boundary_is_not_taken_for_the_boundary():
    at = np.flatnonzero(SCENE.laplace.free)[[40, 90, 200]]
    terms = [tt.terms.LaplaceTerm(SCENE), tt.terms.ForceTerm(SCENE, 1.0)]
    declared = tt.Formulation(terms, [Given(SCENE, at)])
    assert declared.compile().dirichlet is None
    refusal = solvers()["structured"].refusal(declared.compile())
    assert "boundary is neither a bound" in refusal
    found = tt.fit(SCENE, declared)
    np.testing.assert_allclose(found.field.values.reshape(-1)[at], 0.3, atol=1e-6)


@pytest.mark.parametrize(
    ("tags", "share"),
    [
        (frozenset({LaplaceRows("p")}), 0.999),
        (frozenset({LaplaceRows("q")}), 1.0),
        (frozenset({LaplaceRows("p", beside=("m",))}), 1.0),
        (frozenset({LaplaceRows("p", np.full(SCENE.n_voxels, 0.9))}), 1.0),
        (frozenset({LaplaceRows("p", system=SCENE.laplace.variant(screening=9))}), 1),
        (frozenset({Tag.DIRICHLET}), 1.0),
    ],
)
def test_a_false_declaration_is_refused(tags, share):
    with pytest.raises(InputError, match=r"term laplace .*declares .* drop the tag"):
        tt.Formulation([Own(SCENE, share=share, tags=tags)]).compile()


def test_what_the_shelf_declares():
    program = tt.Formulation(
        [tt.terms.LaplaceTerm(SCENE), tt.terms.DragSmoothnessTerm(SCENE)]
    ).compile()
    assert program.laplace_term_of("p") is program.terms[0]
    assert second_field(program) == ("q", program.terms[1])
    scaled = tt.Formulation([tt.terms.VolumeWeightedTerm(SCENE)]).compile()
    assert scaled.laplace_term is None
    assert scaled.laplace_term_of("p") is scaled.terms[0]

"""Fields that differences do not see, against dense algebra."""

import numpy as np
import pytest
import scipy.linalg
import scipy.sparse as sp

from tests.kit import small_scene
from tests.solvers.own_terms import AlongZ, DepthWeighted, Differences
from ttus_opt.problem.formulation import load
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.normal_equations import NormalEquations
from ttus_opt.solvers.primal.least_squares import preconditioner
from ttus_opt.solvers.primal.split import Split
from ttus_opt.solvers.primal.unseen_fields import UnseenFields

SCENE = small_scene("trilinear", shape=(6, 8, 10), n_poses=3)
GRID = SCENE.voxmap.grid
HEAVY = 1e4


def split_of(*terms, formulation="eq10"):
    declared = load(formulation, SCENE)
    for term in terms:
        declared = declared + term
    return Split.of(declared.compile(), 50)


def unseen(split):
    return UnseenFields.of(split.prior, split.wide, split.moving)


def hessian(split):
    terms = (split.prior, *split.wide)
    return sum(t.weight * (t.matrix.T @ t.matrix) for t in terms).toarray()


def test_they_are_constant_along_lines():
    lines = unseen(split_of(AlongZ(SCENE, HEAVY)))
    index = np.arange(SCENE.n_voxels).reshape(GRID.shape)
    found = {tuple(c.nonzero()[0]) for c in lines.fields.toarray().T}
    assert found == {tuple(line) for line in index.reshape(-1, GRID.shape[2])}


def test_there_are_none_where_all_voxels_are_joined():
    """The constant alone is not enough: nearly constant fields are as soft."""
    assert unseen(split_of(Differences(SCENE, HEAVY))) is None


def test_given_values_leave_their_lines_out():
    """With a hard boundary every line ends in given values: none is left open."""
    hard = split_of(AlongZ(SCENE, HEAVY), formulation="eq10_hard_boundary")
    assert not hard.moving.all()
    assert unseen(hard) is None


def test_there_are_none_of_light_terms_and_of_other_rows():
    assert unseen(split_of(AlongZ(SCENE, 1.0))) is None
    assert unseen(split_of(DepthWeighted(SCENE, HEAVY))) is None
    both = split_of(AlongZ(SCENE, HEAVY), DepthWeighted(SCENE, HEAVY))
    assert unseen(both) is None


def test_the_preconditioner_is_close_where_differences_are_heavy():
    """3e-3 without them; 3e3 where soft values are tied by next voxels alone."""
    split = split_of(AlongZ(SCENE, HEAVY))
    nothing = np.zeros(0, dtype=bool)
    made = preconditioner(split, nothing)
    P = hessian(split)
    inverse = np.array([made._system.prior(e) for e in np.eye(len(P))])
    ratios = scipy.linalg.eigh(
        0.5 * (inverse + inverse.T), np.linalg.inv(P), eigvals_only=True
    )
    assert ratios.min() > 0.2 and ratios.max() < 1e3, ratios[[0, -1]]


@pytest.mark.parametrize("term", [AlongZ, Differences])
@pytest.mark.parametrize("weight", [1e2, 1e6])
def test_heavy_differences_are_solved(term, weight):
    program = (load("eq10", SCENE) + term(SCENE, weight)).compile()
    solver = NormalEquations(few_rows=50)
    found = solver.prepare(program, Request(1e-6)).solve()
    assert kkt_residuals(program, found.x, found.duals).worst_relative <= 1e-6
    Q, d = program.normal_equations()
    exact = sp.linalg.spsolve(Q, d)
    assert np.abs(found.x - exact).max() <= 1e-3 * np.abs(exact).max()

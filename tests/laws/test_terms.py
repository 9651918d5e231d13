"""Laws of every term on the shelf: a new file there is tested by existing."""

import inspect

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
import ttus_opt.problem.terms
from tests.kit import small_scene
from ttus_opt.core import plugins
from ttus_opt.problem.program import Program

SCENE = small_scene("trilinear", n_poses=8)

#: What a term needs beyond a scene and a weight, and variants worth testing
OPTIONS: dict[str, list[dict[str, object]]] = {
    "ForceTerm": [
        {},
        {"drag": tt.terms.GlobalCoulomb(SCENE, coefficient=0.3)},
        {"drag": tt.terms.CoulombField(SCENE)},
        {"drag": tt.terms.Viscous(SCENE, sectors=3, bands=2)},
    ],
    "TorqueTerm": [{}, {"drag": tt.terms.CoulombField(SCENE)}],
    "TotalVariationTerm": [{}, {"isotropic": True}],
    "AnisotropicTerm": [{}, {"conductivities": (1.0, 0.3, 2.0)}],
    "TikhonovTerm": [{}, {"reference": "zero"}],
}


def members():
    """All but cvxpy's rows, whose laws are those of the expression they are given."""
    kinds = plugins.classes_of(ttus_opt.problem.terms).values()
    kinds = [kind for kind in kinds if issubclass(kind, tt.Term)]
    return [kind for kind in kinds if kind not in (tt.Term, tt.terms.CvxpyRows)]


CASES = [
    pytest.param(kind, options, id=f"{kind.__name__}-{i}")
    for kind in members()
    for i, options in enumerate(OPTIONS.get(kind.__name__, [{}]))
]
#: Terms whose penalty is no sum of squares: they have no quadratic form
BENT = {"RobustForceTerm", "SparseSourcesTerm", "TotalVariationTerm"}
QUADRATIC_CASES = [
    case
    for case in CASES
    if not (isinstance(case.values[0], type) and case.values[0].__name__ in BENT)
]
each_term = pytest.mark.parametrize(("kind", "options"), CASES)


def made(kind, options, weight=0.7):
    return kind(SCENE, weight, **options)


def program_of(term):
    return Program.build(SCENE, [term], [])


def test_the_shelf_is_found():
    names = {kind.__name__ for kind in members()}
    assert {"LaplaceTerm", "ForceTerm", "TorqueTerm", "RobustForceTerm"} <= names
    assert len(names) >= 14


@each_term
def test_rows_are_well_formed(kind, options):
    term = made(kind, options)
    rows = term.rows()
    assert "p" in rows.blocks or kind.__name__ == "DragSmoothnessTerm"
    for name, matrix in rows.blocks.items():
        assert isinstance(matrix, sp.csr_array)
        assert matrix.shape[0] == len(rows.target)
        assert np.isfinite(matrix.data).all()
        if name not in ("c", "m"):  # a few numbers, no field
            assert matrix.shape[1] == SCENE.n_voxels
    assert np.isfinite(rows.target).all()
    assert len(rows.target) % term.penalty.rows_per_group == 0
    assert term.name
    assert term.formula
    assert inspect.getdoc(inspect.getmodule(kind))


@each_term
def test_gradient_is_the_finite_difference(kind, options):
    """At a random point every penalty is smooth along a random direction."""
    rng = np.random.default_rng(1)
    program = program_of(made(kind, options))
    (term,) = program.terms
    x, d = rng.normal(size=(2, program.n_variables))
    slope = term.weight * float(
        term.penalty.subgradient(term.residual(x)) @ np.asarray(term.matrix @ d)
    )
    h = 1e-6
    difference = (term.cost(x + h * d) - term.cost(x - h * d)) / (2 * h)
    size = abs(slope) + term.cost(x) * 1e-6
    assert difference == pytest.approx(slope, rel=1e-4, abs=1e-3 * size)


@each_term
def test_cost_is_convex_and_not_negative(kind, options):
    rng = np.random.default_rng(3)
    program = program_of(made(kind, options))
    for _ in range(5):
        x, y = rng.normal(size=(2, program.n_variables))
        share = rng.uniform()
        between = program.objective(share * x + (1 - share) * y)
        chord = share * program.objective(x) + (1 - share) * program.objective(y)
        assert 0.0 <= between <= chord * (1 + 1e-12)


@each_term
def test_these_are_no_sums_of_squares(kind, options):
    (term,) = program_of(made(kind, options)).terms
    assert (not term.penalty.quadratic) == (kind.__name__ in BENT)


@pytest.mark.parametrize(("kind", "options"), QUADRATIC_CASES)
def test_quadratic_form_is_positive_semidefinite(kind, options):
    program = program_of(made(kind, options))
    Q, d = program.normal_equations()
    assert abs(Q - Q.T).max() <= 1e-12 * max(abs(Q).max(), 1e-300)
    rng = np.random.default_rng(5)
    for _ in range(5):
        x = rng.normal(size=program.n_variables)
        assert float(x @ (Q @ x)) >= 0.0
        constant = program.objective(np.zeros_like(x))
        value = float(x @ (Q @ x) - 2 * d @ x) + constant
        assert value == pytest.approx(program.objective(x), rel=1e-9)


@each_term
def test_a_weight_scales_the_cost_and_assembles_nothing(kind, options):
    term = made(kind, options)
    rows = term.assembled
    heavier = term.with_weight(7.0)
    assert heavier.assembled is rows
    assert (term.weight, heavier.weight) == (0.7, 7.0)
    x = np.ones(program_of(term).n_variables)
    light, heavy = program_of(term).objective(x), program_of(heavier).objective(x)
    assert heavy == pytest.approx(10.0 * light)

"""Laws of every constraint on the shelf: a new file there is tested by existing."""

import importlib
import inspect
import pkgutil

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt.problem.constraints
from tests.kit import small_scene
from ttus_opt.problem.constraints.base import Bounds, Constraint, LinearRows
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.laplace import LaplaceTerm

SCENE = small_scene("trilinear", shape=(12, 24, 10), n_poses=6)


def members():
    found = []
    for info in pkgutil.iter_modules(ttus_opt.problem.constraints.__path__):
        module = importlib.import_module(f"ttus_opt.problem.constraints.{info.name}")
        for member in vars(module).values():
            own = inspect.isclass(member) and member.__module__ == module.__name__
            if (
                own
                and issubclass(member, Constraint)
                and not inspect.isabstract(member)
            ):
                found.append(member)
    return found


each_constraint = pytest.mark.parametrize("kind", members())


def test_the_shelf_is_found():
    assert {"Sign", "HardBoundary", "Monotone"} <= {k.__name__ for k in members()}
    names = [kind.name for kind in members()]
    assert len(names) == len(set(names))


@each_constraint
def test_rows_are_well_formed(kind):
    constraint = kind(SCENE)
    rows = constraint.rows()
    assert (rows.lower <= rows.upper).all()
    assert (np.isfinite(rows.lower) | np.isfinite(rows.upper)).any()
    if isinstance(rows, LinearRows):
        for matrix in rows.blocks.values():
            assert isinstance(matrix, sp.csr_array)
            assert matrix.shape[0] == len(rows.lower) == len(rows.upper)
            assert (np.diff(matrix.indptr) > 0).all()  # no row without an entry
    else:
        assert isinstance(rows, Bounds)
        assert rows.lower.shape == rows.upper.shape
    assert constraint.assembled is constraint.assembled
    assert constraint.formula
    assert inspect.getdoc(inspect.getmodule(kind))


@each_constraint
def test_the_laplace_field_without_drag_obeys_every_one(kind):
    """Maximum principle: eq. 8 alone has the sign, the growth and the boundary."""
    program = Program.build(SCENE, [LaplaceTerm(SCENE)], [kind(SCENE)])
    x = np.zeros(program.n_variables)
    x[program.variables["p"]] = SCENE.laplace.solve(SCENE.b)
    for member in (*program.constraints, *program.bounds):
        assert member.slack(x).min() >= -1e-9, member.name

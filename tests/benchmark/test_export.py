"""Exported problems are the problems that are solved."""

import numpy as np
import pytest
import scipy.io
import scipy.sparse as sp

from tests.kit import InputError, refuses, small_scene
from ttus_opt.benchmark.export import export_program
from ttus_opt.problem.constraints.signs import Sign
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.registry import solvers


def signed_program():
    scene = small_scene("trilinear", shape=(5, 10, 6), n_poses=6, seed=2)
    declared = load("eq10", scene, force_weight=1.0, torque_weight=1.0)
    return declared.with_constraints(Sign(scene)).compile()


@pytest.mark.filterwarnings("ignore:.*`spmatrix`:DeprecationWarning")  # SciPy 1.18
def test_exported_problem_is_the_same_problem(tmp_path):
    program = signed_program()
    solver = next(
        solvers()[name] for name in ("clarabel", "osqp") if solvers()[name].installed
    )
    p = solver.prepare(program, Request(1e-9)).solve().x
    matlab, archived = export_program(program, tmp_path, "tiny")
    told = scipy.io.loadmat(matlab, squeeze_me=True)
    residuals = [np.sqrt(t.weight) * t.residual(p) for t in program.terms]
    x = np.concatenate([p, *residuals])
    value = 0.5 * x @ (told["P"] @ x) + told["q"] @ x + told["r"]
    assert value == pytest.approx(program.objective(p), rel=1e-12)
    rows = told["A"] @ x
    assert (rows >= told["l"] - 1e-6).all()
    assert (rows <= told["u"] + 1e-6).all()
    assert int(told["n_original"]) == program.n_variables
    with np.load(archived) as archive:
        shape = (int(archive["m"]), int(archive["n"]))
        parts = tuple(archive[f"A_{part}"] for part in ("data", "indices", "indptr"))
        A = sp.csc_array(parts, shape=shape)
    assert abs(A - sp.csc_array(told["A"])).max() == 0.0


def test_group_norms_are_not_exported(tmp_path):
    from tests.solvers.problems import program, term
    from ttus_opt.problem.terms.penalties import Groups

    bent = program([term(np.eye(2), [0, 0], 1.0, Groups(2))])
    refuses(InputError, "not a QP", export_program, bent, tmp_path, "bent")
    assert not list(tmp_path.iterdir())

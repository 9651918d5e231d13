"""Rows of solvers as a run would give them."""

from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.benchmark.row import RunSpec

KKT = {"primal": 0.0, "primal_relative": 0.0, "dual_relative": 2e-8}


def failed(solver, status="time limit"):
    """A row without an answer on S."""
    asked = {"formulation": "eq10", "solver": solver}
    spec = RunSpec("solvers", reference_cases("S")[0], asked, time_limit=100.0)
    return parts()["solvers"].row(spec, status, "ended during first")


def row(solver, seconds, objective, **other):
    """A solved row on S; solved again in a tenth of the time."""
    return failed(solver, "solved") | {
        "detail": "",
        "seconds_first": seconds,
        "seconds_again": seconds / 10,
        "objective": objective,
        "kkt": KKT,
        "solver_memory_bytes": 2**20,
        "peak_memory_bytes": 2**28,
        "memory_by_stage": {"first": 2**28},
        "field_file": f"{solver}.npy",
        **other,
    }

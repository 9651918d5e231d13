"""This problem class as a test set of qpbenchmark.

    qpbenchmark benchmarks/ttus.py --results-path ttus.csv run --author NAME
    qpbenchmark benchmarks/ttus.py --results-path ttus.csv report --author NAME

Small scenes of the bundled example by default; ``TTUS_CASES=S`` (or ``S,M``) takes the
reference cases instead. Run all settings once before asking for one of them: its
report wants every group. The sparse least-squares form is handed over: it has equality
rows, without which several solvers are sent through LSQR.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from dataclasses import replace

import qpbenchmark
from qpbenchmark.solver_settings import SolverSettings
from qpbenchmark.tolerance import Tolerance

from ttus_opt.benchmark import CaseSpec, reference_cases
from ttus_opt.benchmark.row import WEIGHTS
from ttus_opt.problem.formulation import load
from ttus_opt.problem.program import Program
from ttus_opt.solvers.packages.quadratic import OneSided

#: Every formulation here is a QP as it stands
FORMULATIONS = ("eq10", "eq10_hard_boundary", "eq10_sign", "eq10_sign_monotone")

#: Residuals an answer may have, per group of settings
TOLERANCES = {"default": 1e-3, "mid_accuracy": 1e-6, "high_accuracy": 1e-9}

#: Shapes of the small scenes and their number of poses
SMALL = {"XXS": ((8, 18, 8), 10), "XS": ((12, 36, 15), 40)}


class Ttus(qpbenchmark.TestSet):
    """Potential fields fitted to measured probe forces and torques."""

    @property
    def title(self) -> str:
        """Title of the report."""
        return "Haptic patient modelling test set"

    @property
    def description(self) -> str:
        """What the problems are."""
        return (
            "Least squares over a voxel potential field: a Laplace prior, measured "
            "forces and torques, and what is known of sign and growth with depth."
        )

    @property
    def sparse_only(self) -> bool:
        """Matrices are sparse and too large to be dense."""
        return True

    def define_tolerances(self, runtime: float = 60.0) -> None:
        """The usual three, but "default" means 1e-3: its 1.0 would pass anything."""
        self.tolerances = {
            name: Tolerance(primal=value, dual=value, gap=value, runtime=runtime)
            for name, value in TOLERANCES.items()
        }

    def define_solver_settings(self) -> None:
        """Settings per tolerance; absolute ones, as qpbenchmark judges them."""
        self.solver_settings = {}
        for name, value in TOLERANCES.items():
            settings = SolverSettings()
            settings.set_eps_abs(value)
            settings.set_eps_rel(0.0)
            settings.set_param("piqp", "check_duality_gap", True)
            settings.set_param("proxqp", "check_duality_gap", True)
            settings.set_time_limit(self.tolerances[name].runtime)
            self.solver_settings[name] = settings

    def __iter__(self) -> Iterator[qpbenchmark.Problem]:
        """Yield the problems one by one."""
        for case in _cases():
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                scene = case.scene()
            for name in FORMULATIONS:
                program = load(name, scene, **WEIGHTS).compile()
                yield _problem(program, f"{case.name}_{name}")


def _cases() -> list[CaseSpec]:
    asked = os.environ.get("TTUS_CASES", "")
    if asked:
        return [case for name in asked.split(",") for case in reference_cases(name)]
    template = reference_cases("S")[0]
    return [
        replace(template, name=name, shape=shape, n_poses=poses)
        for name, (shape, poses) in SMALL.items()
    ]


def _problem(program: Program, name: str) -> qpbenchmark.Problem:
    split = OneSided.of(program.least_squares_qp())
    some = len(split.h) > 0
    return qpbenchmark.Problem(
        split.P,
        split.q,
        split.G if some else None,
        split.h if some else None,
        split.A,
        split.b,
        split.lb if split.boxed else None,
        split.ub if split.boxed else None,
        name=name,
    )

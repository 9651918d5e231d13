"""What each number of the structured solver buys, on problems with many active limits.

    python benchmarks/ablation.py
    python benchmarks/ablation.py --only patience,share --problems growth,noise
    python benchmarks/ablation.py --case M --only patience --problems "noise drag"

Every number of `solvers.dual.options` is moved alone to each of its trials. A row has
for each problem the V-cycles spent (over those of a whole grid), working sets,
directions and the relative KKT residual, which are the same at every run; a problem
that is not solved to the tolerance is marked. The first row is the defaults'.
docs/benchmark.md tells what came of it.
"""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Iterator
from typing import Any

from ttus_opt.benchmark import reference_cases
from ttus_opt.laplace.multigrid.workspace import Workspace
from ttus_opt.problem import formulation
from ttus_opt.problem.program import Program
from ttus_opt.problem.verify.kkt import kkt_residuals
from ttus_opt.solvers.base import Claim, Request
from ttus_opt.solvers.dual import options
from ttus_opt.solvers.structured import Structured

#: By name: formulation, perturbation of the data, sampling and weight; None for the
#: formulation's own. "heavy" is beyond what single precision can precondition.
PROBLEMS: dict[str, tuple[str, str, str, float | None]] = {
    "sign": ("eq10_sign", "reversed", "trilinear", 100.0),
    "growth": ("eq10_sign_monotone", "reversed", "trilinear", 100.0),
    "noise": ("eq10_sign_monotone", "noise", "voxel-mean", 100.0),
    "noise trilinear": ("eq10_sign_monotone", "noise", "trilinear", 100.0),
    "drag": ("coulomb_drag", "reversed", "trilinear", 100.0),
    "no drag": ("coulomb_drag", "", "trilinear", None),
    "noise drag": ("coulomb_drag", "noise", "voxel-mean", 100.0),
    "heavy": ("eq10", "noise", "trilinear", 1e6),
}

#: Other values of every number of the method
TRIALS: dict[str, tuple[float, ...]] = {
    "REFINEMENTS": (1,),
    "LOOSEST_PRODUCT": (0.0, 1e-4),
    "PRECONDITIONER_RESIDUAL": (0.05,),
    "PRECONDITIONER_ENERGY": (0.0, 0.1),
    "PRECONDITIONER_DELAY": (1,),
    "SUBPROBLEM_ACCURACY": (0.0, 0.1),
    "LOOSEST_SUBPROBLEM": (1e-4, 1e-2),
    "FIELD_ACCURACY": (0.0,),
    "PATIENCE": (0, 10_000),
    "SHARE": (0.1, 1.0),
    "NEIGHBOURHOOD": (1,),
}

WEIGHTS = ("force_weight", "torque_weight")

#: KKT tolerance, and most seconds per solve
REQUEST = Request(1e-6, 600.0)


def build(case: str, problem: str) -> Program:
    """A problem on a reference case."""
    name, how, sampling, weight = PROBLEMS[problem]
    spec = reference_cases(case)[0].sampled(sampling).perturbed(how)
    weights = {} if weight is None else dict.fromkeys(WEIGHTS, weight)
    return formulation.load(name, spec.scene(), **weights).compile()


def variants(only: list[str]) -> Iterator[str]:
    """The defaults, then every number at each of its trials, set while it is tried."""
    yield "defaults"
    for name, trials in TRIALS.items():
        usual = getattr(options, name)
        for value in trials if not only or name.lower() in only else ():
            setattr(options, name, value)
            yield f"{name.lower()} {value:g}"
            setattr(options, name, usual)


@contextlib.contextmanager
def counted() -> Iterator[list[int]]:
    """Values of the finest level in every V-cycle meanwhile, boxes of a grid too."""
    sizes: list[int] = []
    original = Workspace.v_cycle

    def counting(self: Workspace, **options: Any) -> None:
        sizes.append(self.b.size)
        original(self, **options)

    Workspace.v_cycle = counting  # type: ignore[method-assign]
    try:
        yield sizes
    finally:
        Workspace.v_cycle = original  # type: ignore[method-assign]


def measured(program: Program) -> str:
    """One solve in a few words."""
    with counted() as sizes:
        found = Structured().prepare(program, REQUEST).solve()
    whole = Workspace(program.laplace.multigrid.hierarchy).b.size
    assert found.x is not None
    kkt = kkt_residuals(program, found.x, found.duals).worst_relative
    failed = found.claim is not Claim.DONE or kkt > REQUEST.tolerance
    sets = found.detail.split(" ")[0]
    mark = "!" if failed else " "
    return f"{sum(sizes) / whole:7.0f} {sets:>3} {found.iterations:4} {kkt:.0e}{mark}"


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--case", default="S")
    parser.add_argument("--only", default="", help="options, separated by commas")
    parser.add_argument("--problems", default=",".join(PROBLEMS))
    chosen = parser.parse_args()
    problems = chosen.problems.split(",")
    programs = [build(chosen.case, name) for name in problems]
    for program in programs:  # compiles, imports
        Structured().prepare(program, Request(1e-2, 5.0)).solve()
    print(f"{'':32}", " | ".join(f"{name:26}" for name in problems))
    for label in variants(chosen.only.split(",") if chosen.only else []):
        cells = [measured(program) for program in programs]
        print(f"{label:32}", " | ".join(cells), flush=True)


if __name__ == "__main__":
    main()

"""How good the choice of ``solver="auto"`` is, over the shelf of formulations.

    python benchmarks/solver_cost.py --shape 16,54,24 --limit 120

Every solver that estimates its cost solves every formulation it takes, each in a
process of its own; printed are CPU seconds beside the estimate, and how much longer the
chosen solver took than the best. Constants in ``ttus_opt/solvers/`` come from these
figures.
"""

from __future__ import annotations

import argparse
import importlib.util
import multiprocessing
import queue
import resource
import sys
import time
import warnings
from dataclasses import dataclass, field, replace

from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.fitting.batch import Fitter
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.compression import Compression
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.solution import Status
from ttus_opt.scene import Scene
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Request

#: Differences below this are those of starting up [s]
FLOOR = 0.25


@dataclass(frozen=True)
class Choice:
    """What solvers took and estimated for one formulation.

    Attributes:
        formulation: Its name.
        chosen: What "auto" takes first.
        measured: CPU seconds by solver; infinite where it did not solve it, or took
            a second longer than another [s].
        estimated: By solver [s].
    """

    formulation: str
    chosen: str
    measured: dict[str, float] = field(repr=False)
    estimated: dict[str, float] = field(repr=False)

    @property
    def ratio(self) -> float:
        """How many times as long as the best solver the chosen one took."""
        best = min(self.measured.values())
        return (self.measured[self.chosen] + FLOOR) / (best + FLOOR)


def scene_of(shape: tuple[int, int, int], n_poses: int) -> Scene:
    """The example's recordings on a grid."""
    case = replace(reference_cases("S")[0], shape=shape, n_poses=n_poses)
    scene = case.build()
    scene.laplace.multigrid  # noqa: B018  (the same for all, made once)
    for package in ("cvxpy", "qpsolvers", "clarabel", "osqp", "scs"):
        if importlib.util.find_spec(package):  # loading is no part of the comparison
            importlib.import_module(package)
    return scene


def choice(scene: Scene, formulation: str, limit: float) -> Choice:
    """Solve a formulation by every solver that estimates.

    Args:
        scene: What it is built over.
        formulation: Its name.
        limit: Most seconds for a solver [s].
    """
    declared = shelf.load(formulation, scene)
    if declared.search is not None:
        declared = declared.search.build(declared.search.neutral_value)
    program = Compression()(reduce(declared.compile()).program)
    able = registry.candidates("auto", program)
    measured: dict[str, float] = {}
    for solver in able:  # one that takes longer than another is not the best
        enough = min([limit, *(1.0 + seconds for seconds in measured.values())])
        measured[solver.name] = _seconds(declared, solver.name, enough)
    estimated = {solver.name: solver.cost(program) for solver in able}
    return Choice(formulation, able[0].name, measured, estimated)


def _seconds(declared: Formulation, solver: str, limit: float) -> float:
    """CPU seconds of set-up and solve in a process of its own."""
    context = multiprocessing.get_context("fork")
    answers: multiprocessing.Queue[float] = context.Queue()
    process = context.Process(target=_run, args=(declared, solver, limit, answers))
    process.start()
    try:
        while True:
            alive = process.is_alive()  # before looking: it may end in between
            try:
                return answers.get(timeout=0.2)
            except queue.Empty:
                if not alive:
                    return float("inf")
    finally:
        process.kill()
        process.join()


def _run(declared: Formulation, solver: str, limit: float, answers: object) -> None:
    # of CPU time: a busy machine is no reason to give up
    resource.setrlimit(resource.RLIMIT_CPU, (int(limit) + 1, int(limit) + 1))
    start = time.process_time()
    solution = Fitter(declared, solver=solver, request=Request(1e-6)).solve()
    spent = time.process_time() - start
    solved = solution.status is Status.SOLVED
    answers.put(spent if solved else float("inf"))  # type: ignore[attr-defined]


def main(words: list[str]) -> int:
    """Print the table; 1 where a choice took more than twice as long as the best."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--shape", default="12,36,15")
    parser.add_argument("--poses", type=int, default=60)
    parser.add_argument("--limit", type=float, default=60.0)
    parser.add_argument("--formulations", default="")
    given = parser.parse_args(words)
    n_r, n_theta, n_z = (int(n) for n in given.shape.split(","))
    scene = scene_of((n_r, n_theta, n_z), given.poses)
    names = [info.name for info in shelf.available()]
    if given.formulations:
        names = given.formulations.split(",")
    worst = 0.0
    for name in names:
        told = choice(scene, name, given.limit)
        worst = max(worst, told.ratio)
        figures = ", ".join(
            f"{solver} {told.measured[solver]:.2f} ({told.estimated[solver]:.2f})"
            for solver in told.measured
        )
        print(
            f"{name}: {told.chosen}, {told.ratio:.1f} × the best: {figures}", flush=True
        )
    print(f"worst: {worst:.1f} × the best; in brackets what was estimated [s]")
    return int(worst > 2.0)


if __name__ == "__main__":
    warnings.simplefilter("ignore")
    sys.exit(main(sys.argv[1:]))

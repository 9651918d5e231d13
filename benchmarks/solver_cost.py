"""How good the choice of ``solver="auto"`` is, over the shelf of formulations.

    python benchmarks/solver_cost.py --shape 24,72,30 --poses 200 --all --limit 120

Every solver that estimates its cost (with ``--all`` every one that is installed) solves
every formulation it takes, each in a process of its own that has solved a small one
before; printed are CPU seconds, which include multigrids, beside the estimate, and how
much longer the chosen solver took than the best. Constants in ``ttus_opt/solvers/``
come from these figures.
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
from ttus_opt.contact.scene import Scene
from ttus_opt.fitting.batch import Fitter
from ttus_opt.problem.compression import Compression
from ttus_opt.problem.formulation import Formulation, available, load
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.solution import Status
from ttus_opt.solvers import registry
from ttus_opt.solvers.base import Request

#: Differences below this are noise [s]
FLOOR = 0.05

#: Voxels in r, θ, z and poses of the stand-in that loads and compiles what is called
SMALL = ((12, 32, 16), 6)


@dataclass(frozen=True)
class Choice:
    """What solvers took and estimated for one formulation.

    Attributes:
        formulation: Its name.
        chosen: What "auto" takes first.
        measured: CPU seconds by solver, the chosen one in front; infinite where it did
            not solve it, or took a second longer than another [s].
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
    scene = case.scene()
    for package in ("cvxpy", "qpsolvers", "clarabel", "osqp", "scs"):
        if importlib.util.find_spec(package):  # loading is no part of the comparison
            importlib.import_module(package)
    return scene


def choice(
    scenes: tuple[Scene, Scene], formulation: str, limit: float, *, every: bool = False
) -> Choice:
    """Solve a formulation by every solver that estimates, or by every one.

    Args:
        scenes: What it is built over, and a small one.
        formulation: Its name.
        limit: Most seconds for a solver [s].
        every: Those too that "auto" leaves out.
    """
    declared, small = (_declared(formulation, scene) for scene in scenes)
    program = Compression()(reduce(declared.compile()).program)
    able = registry.candidates("auto", program)
    if every:
        able += [
            solver
            for solver in registry.solvers().values()
            if solver not in able and solver.installed and not solver.refusal(program)
        ]
    measured: dict[str, float] = {}
    for solver in able:  # one that takes longer than another is not the best
        enough = min([limit, *(1.0 + seconds for seconds in measured.values())])
        measured[solver.name] = _seconds((small, declared), solver.name, enough)
    estimated = {solver.name: solver.cost(program) for solver in able}
    return Choice(formulation, able[0].name, measured, estimated)


def _declared(formulation: str, scene: Scene) -> Formulation:
    """A formulation, or one convex fit of what it searches."""
    declared = load(formulation, scene)
    if declared.search is not None:
        declared = declared.search.build(declared.search.neutral_value)
    return declared


def _seconds(both: tuple[Formulation, Formulation], solver: str, limit: float) -> float:
    """CPU seconds of set-up and solve in a process of its own."""
    context = multiprocessing.get_context("fork")
    answers: multiprocessing.Queue[float] = context.Queue()
    process = context.Process(target=_run, args=(both, solver, limit, answers))
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


def _run(
    both: tuple[Formulation, Formulation], solver: str, limit: float, answers: object
) -> None:
    small, declared = both
    if not registry.solvers()[solver].module:  # its own code, compiled on first call
        Fitter(small, solver=solver, request=Request(1e-6)).solve()
    start = time.process_time()
    # of CPU time: a busy machine is no reason to give up
    most = int(start + limit) + 1
    resource.setrlimit(resource.RLIMIT_CPU, (most, most))
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
    parser.add_argument("--all", action="store_true", help="every installed solver")
    given = parser.parse_args(words)
    n_r, n_theta, n_z = (int(n) for n in given.shape.split(","))
    scenes = scene_of((n_r, n_theta, n_z), given.poses), scene_of(*SMALL)
    names = [info.name for info in available()]
    if given.formulations:
        names = given.formulations.split(",")
    worst = 0.0
    for name in names:
        told = choice(scenes, name, given.limit, every=given.all)
        worst = max(worst, told.ratio)
        figures = ", ".join(
            f"{solver} {told.measured[solver]:.3g} ({told.estimated[solver]:.3g})"
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

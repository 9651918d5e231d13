"""One run of a solver: assembly, set-up and first solve, and solves of other values."""

from __future__ import annotations

import statistics
import time
import warnings
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from ttus_opt.benchmark import memory
from ttus_opt.benchmark.active_limits import active_limits
from ttus_opt.benchmark.cases import with_new_values
from ttus_opt.benchmark.own_solver import AUTO, solver_of
from ttus_opt.benchmark.progress import Progress
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.fitting.batch import Fitter
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.solution import Solution
from ttus_opt.scene import Scene
from ttus_opt.solvers.base import Request, Solver
from ttus_opt.solvers.registry import candidates

#: Folder of the fields in that of the results
FIELDS = "fields"

#: Most time for one solve of the small stand-in [s]
WARM_UP = 20.0


def label(formulation: str) -> str:
    """A formulation's name without folder and suffix.

    >>> label("folder/mine.py")
    'mine'
    """
    return formulation.replace("\\", "/").rsplit("/", 1)[-1].split(".py")[0]


@dataclass
class _Solves:
    """What the repeats gave: first solution, last of other values, times [s]."""

    solution: Solution | None = None
    second: Solution | None = None
    first: list[float] = field(default_factory=list)
    again: list[float] = field(default_factory=list)
    cpu_first: list[float] = field(default_factory=list)
    cpu_again: list[float] = field(default_factory=list)


def measured(spec: RunSpec, begin: Progress) -> Row:
    """Measure one run in this process.

    Args:
        spec: A run of the solvers' part.
        begin: To be called with every stage; keeps the field.

    Returns:
        The figures, some of `parts.solvers.FIGURES`.
    """
    solver = solver_of(spec.options)
    request = Request(spec.options["tolerance"], spec.time_limit, begin.reached)
    begin("warm-up")
    _warm_up(spec, solver, request)
    begin("scene")
    scene = spec.scene_case.build()
    begin("program")
    both = declared(spec, scene), declared(spec, with_new_values(scene, seed=1))
    for each in both:
        each.compile()  # what terms and constraints keep is made here, for all alike
    if solver == AUTO:  # it may have taken another one on the small stand-in
        begin("warm-up")
        _warm_up(spec, _first_choice(both[0]), request)
    base = memory.current_bytes()
    told = _solved(spec, solver, request, both, begin)
    begin.end()
    assert told.solution is not None
    solving = max(begin.peaks.get(name, 0) for name in ("first", "again"))
    first = statistics.median(told.first)
    answer = _answer(spec, told.solution, begin) | _again(told)
    if answer["status"] == "solved" and first > spec.time_limit:
        answer |= {"status": "time limit", "detail": f"solved after {first:.3g} s"}
    return answer | {
        "poses": len(scene.trajectory),
        "seconds_assembly": told.solution.timings.assembly,
        "seconds_first": first,
        "cpu_first": statistics.median(told.cpu_first),
        "seconds_each": {"first": told.first, "again": told.again},
        "solver_memory_bytes": max(0, solving - base),
    }


def _solved(
    spec: RunSpec,
    solver: Solver | Literal["auto"],
    request: Request,
    formulations: tuple[Formulation, Formulation],
    begin: Progress,
) -> _Solves:
    """Solve the one formulation, then the other of the same structure, repeatedly."""
    original, changed = formulations
    told = _Solves()
    for _ in range(spec.options["repeat"]):
        begin("first")
        cpu = time.process_time()
        fitter = Fitter(original, solver=solver, request=request)
        latest = fitter.solve()
        told.cpu_first.append(time.process_time() - cpu)
        told.solution = told.solution or latest
        told.first.append(latest.timings.setup + latest.timings.solve)
        if latest.verified_field is None:
            break
        begin("again")
        cpu = time.process_time()
        fitter.update(changed)
        told.second = fitter.solve()
        told.cpu_again.append(time.process_time() - cpu)
        told.again.append(told.second.timings.again or 0.0)
        del fitter, latest
        if sum(told.first) + sum(told.again) > spec.time_limit:
            break
    return told


def declared(spec: RunSpec, scene: Scene) -> Formulation:
    """The formulation of a run on a scene."""
    return shelf.load(spec.options["formulation"], scene, **spec.options["options"])


def _warm_up(spec: RunSpec, solver: Solver | Literal["auto"], request: Request) -> None:
    """Imports and compilation are no part of what is compared."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        small = declared(spec, spec.scene_case.small().build())
        brief = replace(request, time_limit=WARM_UP, told=None)
        fitter = Fitter(small, solver=solver, request=brief)
        fitter.solve()
        fitter.update(small)
        fitter.solve()


def _first_choice(declared: Formulation) -> Solver:
    """What "auto" tries first on the case itself."""
    return candidates(AUTO, reduce(declared.compile()).program)[0]


def _answer(spec: RunSpec, solution: Solution, begin: Progress) -> Row:
    """Figures of the first solution; its field is kept where it is verified."""
    row = {
        "taken": solution.solver,
        "status": solution.status.name.lower().replace("_", " "),
        "detail": " ".join(solution.detail.split()),
        "kkt": None if solution.kkt is None else solution.kkt.as_dict(),
        "objective": solution.objective,
        "iterations": solution.iterations,
    }
    if solution.verified_field is not None and solution.candidate is not None:
        formulation, solver = label(spec.options["formulation"]), spec.options["solver"]
        names = spec.case_name, formulation, solver
        row["field_file"] = f"{'-'.join(names)}-{spec.key[-12:]}.npy"
        np.save(begin.keep(f"{FIELDS}/{row['field_file']}"), solution.variables["p"])
        row["active_limits"] = active_limits(
            solution.program, solution.candidate, solution.duals
        )
    return row


def _again(told: _Solves) -> Row:
    """Seconds of solves of other values, or why there are none."""
    if told.second is not None and told.second.verified_field is None:
        status = told.second.status.name.lower()
        return {"detail": f"solved first, then {status} on other values"}
    if not told.again:
        return {}
    return {
        "seconds_again": statistics.median(told.again),
        "cpu_again": statistics.median(told.cpu_again),
    }

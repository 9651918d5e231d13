"""One run of a solver: assembly, set-up and first solve, solves with other values.

A user's own solver comes to the process of a run by path or as an object. An object is
pickled, so its class must be importable there. A file is identified by a
digest of its text, so that rows of another version are not reused.
"""

from __future__ import annotations

import base64
import pickle
import statistics
import time
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ttus_opt.benchmark import machine
from ttus_opt.benchmark.cases import with_new_values
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.row import AUTO, Row, RunSpec
from ttus_opt.contact.scene import Scene
from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import Fitter
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import reduce
from ttus_opt.problem.solution import Solution
from ttus_opt.problem.verify.kkt import Duals
from ttus_opt.solvers.base import Request, Solver
from ttus_opt.solvers.registry import asked_for, candidates, solvers


def options_of(given: str | Path | Solver) -> dict[str, Any]:
    """A solver as options of a run: its name, and the source of an own one.

    Args:
        given: A name, `AUTO`, the path of a file with ``SOLVERS``, or a solver.

    Returns:
        ``solver``, and for an own one ``own``: plain data, for JSON.

    Raises:
        InputError: An unknown solver, an own one with the name of a built-in one, or
            one that cannot be sent to another process.
    """
    if given == AUTO:
        return {"solver": AUTO}
    solver = asked_for(given)
    if isinstance(given, str) and given in solvers():
        return {"solver": given}
    if solver is solvers().get(solver.name):
        return {"solver": solver.name}
    if solver.name in solvers():
        raise InputError(
            f"your solver has the name of one of the package's, {solver.name!r}: give "
            "it another name"
        )
    if isinstance(given, Solver):
        return {"solver": solver.name, "own": {"pickle": _pickled(given)}}
    path = Path(given).resolve()
    return {"solver": solver.name, "own": {"path": str(path), **version(path)}}


def solver_of(options: Mapping[str, Any]) -> Solver | Literal["auto"]:
    """The solver from a run's options, in any process."""
    own = options.get("own")
    if options["solver"] == AUTO:
        return AUTO
    if own is None:
        return asked_for(str(options["solver"]))
    if "path" in own:
        return asked_for(Path(own["path"]))
    found: Solver = pickle.loads(base64.b64decode(own["pickle"]))
    return found


def version(path: Path) -> dict[str, str]:
    """Digest of a user's file; nothing for a name."""
    if path.suffix != ".py" or not path.exists():
        return {}
    return {"version": io.sha256(path)[:12]}


def _pickled(solver: Solver) -> str:
    """The object as text; `InputError` if it or its class cannot be pickled."""
    name = type(solver).__qualname__
    if type(solver).__module__ == "__main__" or "<locals>" in name:
        raise InputError(
            f"solver {name} is defined in a script, notebook or function, which no "
            "other process can import: put it in a file and give its path"
        )
    try:
        return base64.b64encode(pickle.dumps(solver)).decode()
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise InputError(
            f"solver {name} cannot be sent to another process: {error}: put it in a "
            "file and give its path"
        ) from error


#: Subfolder of the fields
FIELDS = "fields"

#: Time limit of a solve in the warm-up [s]
WARM_UP = 20.0


#: Threshold of a multiplier relative to the largest one, and of the largest one
#: relative to the objective's gradient, below which it is rounding [–]
NONZERO = 1e-6


@dataclass
class _Solves:
    """First solution, last one with other values, and times of all repetitions [s]."""

    solution: Solution | None = None
    second: Solution | None = None
    first: list[float] = field(default_factory=list)
    again: list[float] = field(default_factory=list)
    cpu_first: list[float] = field(default_factory=list)
    cpu_again: list[float] = field(default_factory=list)


def measured(spec: RunSpec, begin: Progress) -> Row:
    """Measure one run of the solvers' part in this process.

    Returns:
        Some of the values in `parts.solvers.FIGURES`.
    """
    solver = solver_of(spec.options)
    request = Request(spec.options["tolerance"], spec.time_limit, begin.reached)
    begin("warm-up")
    _warm_up(spec, solver, request)
    begin("scene")
    scene = spec.scene_case.scene()
    begin("program")
    both = declared(spec, scene), declared(spec, with_new_values(scene, seed=1))
    for each in both:
        each.compile()  # fills the caches of terms and constraints for every solver
    if solver == AUTO:  # it may have chosen another solver on the small case
        begin("warm-up")
        chosen = candidates(AUTO, reduce(both[0].compile()).program)[0]
        _warm_up(spec, chosen, request)
    base = machine.resident_bytes()
    solves = _solved(spec, solver, request, both, begin)
    begin.end()
    assert solves.solution is not None
    solving = max(begin.peaks.get(name, 0) for name in ("first", "again"))
    first = statistics.median(solves.first)
    answer = _answer(spec, solves.solution, begin) | _again(solves)
    if answer["status"] == "solved" and first > spec.time_limit:
        answer |= {"status": "time limit", "detail": f"solved after {first:.3g} s"}
    return answer | {
        "poses": len(scene.trajectory),
        "seconds_assembly": solves.solution.timings.assembly,
        "seconds_first": first,
        "cpu_first": statistics.median(solves.cpu_first),
        "seconds_each": {"first": solves.first, "again": solves.again},
        "solver_memory_bytes": max(0, solving - base),
    }


def _solved(
    spec: RunSpec,
    solver: Solver | Literal["auto"],
    request: Request,
    formulations: tuple[Formulation, Formulation],
    begin: Progress,
) -> _Solves:
    """Solve one formulation, then the other of the same structure, repeatedly."""
    original, changed = formulations
    solves = _Solves()
    for _ in range(spec.options["repeat"]):
        begin("first")
        cpu = time.process_time()
        fitter = Fitter(original, solver=solver, request=request)
        latest = fitter.solve()
        solves.cpu_first.append(time.process_time() - cpu)
        solves.solution = solves.solution or latest
        solves.first.append(latest.timings.setup + latest.timings.solve)
        if latest.verified_field is None:
            break
        begin("again")
        cpu = time.process_time()
        fitter.update(changed)
        solves.second = fitter.solve()
        solves.cpu_again.append(time.process_time() - cpu)
        solves.again.append(solves.second.timings.again or 0.0)
        del fitter, latest
        if sum(solves.first) + sum(solves.again) > spec.time_limit:
            break
    return solves


def declared(spec: RunSpec, scene: Scene) -> Formulation:
    """The formulation of a run on a scene."""
    return load(spec.options["formulation"], scene, **spec.options["options"])


def _warm_up(spec: RunSpec, solver: Solver | Literal["auto"], request: Request) -> None:
    """Import and compile before the measurement."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        small = declared(spec, spec.scene_case.small().scene())
        brief = replace(request, time_limit=WARM_UP, told=None)
        fitter = Fitter(small, solver=solver, request=brief)
        fitter.solve()
        fitter.update(small)
        fitter.solve()


def _answer(spec: RunSpec, solution: Solution, begin: Progress) -> Row:
    """Values of the first solution; its field is kept if it is verified."""
    row = {
        "taken": solution.solver,
        "status": solution.status.name.lower().replace("_", " "),
        "detail": " ".join(solution.detail.split()),
        "kkt": None if solution.kkt is None else solution.kkt.as_dict(),
        "objective": solution.objective,
        "iterations": solution.iterations,
    }
    if solution.verified_field is not None and solution.candidate is not None:
        formulation = Path(spec.options["formulation"]).stem
        names = spec.case_name, formulation, spec.options["solver"]
        row["field_file"] = f"{'-'.join(names)}-{spec.key[-12:]}.npy"
        np.save(begin.keep(f"{FIELDS}/{row['field_file']}"), solution.variables["p"])
        row["active_limits"] = active_limits(
            solution.program, solution.candidate, solution.duals
        )
    return row


def _again(solves: _Solves) -> Row:
    """Seconds of solves with other values, or why there are none."""
    if solves.second is not None and solves.second.verified_field is None:
        status = solves.second.status.name.lower()
        return {"detail": f"solved first, then {status} on other values"}
    if not solves.again:
        return {}
    return {
        "seconds_again": statistics.median(solves.again),
        "cpu_again": statistics.median(solves.cpu_again),
    }


def active_limits(program: Program, x: Array, duals: Duals) -> int:
    """Number of bounds and inequality rows with a nonzero multiplier [–].

    Interior-point methods leave a small multiplier at every limit, so that a few more
    may count.

    Args:
        program: The declared problem.
        x: A verified solution, shape (n,).
        duals: Its multipliers.
    """
    multipliers = [
        np.abs(duals.rows[member.name])[member.lower < member.upper]
        for member in program.constraints
        if member.name in duals.rows
    ]
    if program.bounds and duals.bounds is not None:
        lower, upper = program.box
        multipliers.append(np.abs(duals.bounds)[lower < upper])
    sizes = np.concatenate([*multipliers, np.zeros(0)])
    largest = float(sizes.max(initial=0.0))
    if largest <= NONZERO * _steepest(program, x):
        return 0
    return int(np.count_nonzero(sizes > NONZERO * largest))


def _steepest(program: Program, x: Array) -> float:
    """Largest entry among the summands of the objective's gradient."""
    return max(
        float(np.abs(part).max(initial=0.0))
        for part in (program.curvature_times(x), program.gradient_at_zero())
    )

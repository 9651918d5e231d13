"""The process of one run: ``python -m ttus_opt.benchmark.worker FOLDER``.

Reads ``run.json`` in the folder, appends the stages as they begin to
``stages.jsonl``, leaves ``row.json`` and the field. Its parent watches the stages and
ends it when one takes too long (`ttus_opt.benchmark.isolation`).
"""

from __future__ import annotations

import json
import statistics
import sys
import warnings
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.benchmark import memory
from ttus_opt.benchmark.active_limits import active_limits
from ttus_opt.benchmark.cases import with_new_values
from ttus_opt.benchmark.isolation import ANSWER, QUESTION
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.benchmark.stages import STAGES, Stages
from ttus_opt.errors import SolverUnavailableError, TtusError
from ttus_opt.fitting.batch import Fitter
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.solution import Solution
from ttus_opt.scene import Scene
from ttus_opt.solvers.base import Request


def run(spec: RunSpec, folder: Path) -> Row:
    """Measure one run in this process.

    Args:
        spec: What to run.
        folder: Where the stages and the field go.

    Returns:
        The row.
    """
    begin = Stages(folder / STAGES)
    begin("warm-up")
    request = Request(spec.tolerance, spec.time_limit)
    _warm_up(spec, request)
    begin("scene")
    scene = spec.case.build()
    begin("program")
    declared = _declared(spec, scene)
    changed = _declared(spec, with_new_values(scene, seed=1))
    for each in (declared, changed):
        each.compile()  # what terms and constraints keep is made here, for all alike
    base = memory.current_bytes()
    first: list[float] = []
    again: list[float] = []
    solution = second = None
    for _ in range(spec.repeat):
        begin("first")
        fitter = Fitter(declared, solver=spec.solver, request=request)
        latest = fitter.solve()
        solution = solution or latest
        first.append(latest.timings.setup + latest.timings.solve)
        if latest.verified_field is None:
            break
        begin("again")
        fitter.update(changed)
        second = fitter.solve()
        again.append(second.timings.again or 0.0)
        del fitter, latest
        if sum(first) + sum(again) > spec.time_limit:
            break
    begin.end()
    assert solution is not None
    return _row(spec, scene, solution, second, (first, again), (base, begin), folder)


def _declared(spec: RunSpec, scene: Scene) -> Formulation:
    return shelf.load(spec.formulation, scene, **spec.options)


def _warm_up(spec: RunSpec, request: Request) -> None:
    """Imports and compilation are no part of what is compared."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        small = _declared(spec, spec.case.small().build())
        fitter = Fitter(
            small, solver=spec.solver, request=replace(request, time_limit=20.0)
        )
        fitter.solve()
        fitter.update(small)
        fitter.solve()


def _row(
    spec: RunSpec,
    scene: Scene,
    solution: Solution,
    second: Solution | None,
    seconds: tuple[list[float], list[float]],
    measured: tuple[int, Stages],
    folder: Path,
) -> Row:
    (first, again), (base, stages) = seconds, measured
    name, active = "", None
    if solution.verified_field is not None and solution.candidate is not None:
        name = f"{spec.key}.npy"
        np.save(folder / name, solution.variables["p"])
        active = active_limits(solution.program, solution.candidate, solution.duals)
    status = solution.status.name.lower().replace("_", " ")
    detail = solution.detail
    if second is not None and second.verified_field is None:
        detail = f"solved first, then {second.status.name.lower()} on other values"
        again = []
    solving = [stages.peaks.get(name, 0) for name in ("first", "again")]
    return Row(
        key=spec.key,
        case=spec.case.name,
        formulation=spec.label,
        solver=solution.solver,
        status=status,
        voxels=scene.n_voxels,
        poses=len(scene.trajectory),
        time_limit=spec.time_limit,
        seconds_assembly=solution.timings.assembly,
        seconds_first=statistics.median(first),
        seconds_again=statistics.median(again) if again else None,
        seconds_each={"first": first, "again": again},
        peak_memory_bytes=max(stages.peaks.values()),
        solver_memory_bytes=max(0, max(solving) - base),
        memory_by_stage=dict(stages.peaks),
        kkt=None if solution.kkt is None else solution.kkt.as_dict(),
        objective=solution.objective,
        iterations=solution.iterations,
        active_limits=active,
        detail=" ".join(detail.split()),
        field_file=name,
    )


def main(arguments: list[str]) -> None:
    """Run what the folder asks for.

    Args:
        arguments: The folder.
    """
    memory.volunteer()
    folder = Path(arguments[0])
    spec = RunSpec.from_dict(json.loads((folder / QUESTION).read_text("utf-8")))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            row = run(spec, folder)
        except SolverUnavailableError as error:
            row = Row.failed(spec, "not installed", str(error))
        except MemoryError as error:
            row = Row.failed(spec, "memory limit", f"out of memory {error}".strip())
        except TtusError as error:
            row = Row.failed(spec, "refused", str(error))
    content: dict[str, Any] = row.as_dict()
    (folder / ANSWER).write_text(json.dumps(content), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])

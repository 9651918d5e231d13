"""Part ``profile``: where one fit's time goes, and how much of it memory allows."""

from __future__ import annotations

import statistics
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt import scene
from ttus_opt.benchmark import account
from ttus_opt.benchmark import spans as name
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.parts.base import (
    MEASURED,
    Column,
    Figures,
    Part,
    PartSpec,
    scene_case,
)
from ttus_opt.benchmark.profiler import Profiler, Watch
from ttus_opt.benchmark.stages import Stages
from ttus_opt.benchmark.suite import WEIGHTS
from ttus_opt.benchmark.summary import seconds
from ttus_opt.benchmark.traffic import Bandwidth, Traffic
from ttus_opt.errors import InputError
from ttus_opt.fitting import batch
from ttus_opt.fitting.batch import Fitter
from ttus_opt.laplace.system import RTOL, LaplaceSystem
from ttus_opt.multigrid import Multigrid, v_cycle
from ttus_opt.multigrid.pcg import Vectors
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import Scene
from ttus_opt.solvers.base import Request
from ttus_opt.solvers.dual import solver as dual_solver
from ttus_opt.solvers.dual.conjugate_directions import Directions
from ttus_opt.solvers.dual.preconditioner import RoughDual
from ttus_opt.solvers.dual.solver import DualSolver
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.structured import Structured

#: KKT tolerance of the fit, as the solvers' rows have it
TOLERANCE = 1e-6

#: How often a solve and a V-cycle are timed alone
SOLVES, CYCLES = 3, 20

WATCHES = (
    Watch(LaplaceSystem, "assemble", name.LAPLACE),
    Watch(scene, "contact_rows", name.ROWS),
    Watch(Formulation, "compile", name.PROGRAM),
    Watch(Structured, "prepare", name.PREPARE),
    Watch(Multigrid, "__init__", name.MULTIGRID),
    Watch(DualSolver, "solve", name.DUAL),
    Watch(DualSolver, "_prior_field", name.PRIOR),
    Watch(
        dual_solver, "rough_preconditioner", name.ROUGH_SETUP, returns=name.ROUGH_DUAL
    ),
    Watch(RoughDual, "apply", name.ROUGH),
    Watch(Directions, "extend", name.ALGEBRA, aside=True),
    Watch(Directions, "project", name.ALGEBRA, aside=True),
    Watch(Directions, "step", name.ALGEBRA, aside=True),
    Watch(DualSystem, "apply", name.EXACT),
    Watch(DualSystem, "response", name.RESPONSE, outside=name.EXACT),
    Watch(Multigrid, "solve", name.SOLVE),
    Watch(Vectors, "correct", name.CORRECTION),
    Watch(Multigrid, "_residual", name.DOUBLE),
    Watch(Multigrid, "_add", name.DOUBLE),
    Watch(v_cycle, "cycle", name.CYCLE),
    Watch(batch, "judged", name.VERIFY),
)


class ProfilePart(Part):
    """One run per case: eq. 10 by `structured`."""

    name = "profile"
    title = "Where the time of a fit goes"
    legend = (
        "One fit of eq. 10 by `structured` once its files are read, from assembly to "
        "an answer verified; compilation is done before. *Total* is a span with all "
        "it calls, *own* without; own seconds add up to the fit's. Directions' algebra "
        "calls products, which stand beside it and not below. Timing costs something "
        "itself: the first row also says what the same fit took without."
    )
    columns = (
        Column("span", "path", lambda path: "· " * (len(path) - 1) + path[-1]),
        Column("calls", "calls", lambda value: f"{value:,}"),
        Column("total [s]", "total", seconds),
        Column("[%]", "ratio_to_fit", lambda value: f"{100.0 * value:.1f}"),
        Column("own [s]", "own", seconds),
        Column("[%]", "own_share", lambda value: f"{100.0 * value:.1f}"),
    )

    def plan(self, cases: Sequence[CaseSpec], time_limit: float) -> list[PartSpec]:
        """Every case, the large copy as large as the cache asks for."""
        return [
            PartSpec(self.name, case, {"largest_copy": None}, time_limit)
            for case in cases
        ]

    def measure(self, spec: PartSpec, begin: Stages) -> list[Figures]:
        """Fit without and with the clock running, then count bytes."""
        case = scene_case(spec)
        begin("warm-up")
        _fitted(case.small(), Profiler(), spec.time_limit, WATCHES)
        begin("fit")
        for _ in range(2):  # the first one also asks the system for its memory
            bare = Profiler()
            _fitted(case, bare, spec.time_limit)
        plain = bare.nodes()[0].total
        begin("profiled fit")
        profiler = Profiler()
        made = _fitted(case, profiler, spec.time_limit, WATCHES)
        rows = _rows(profiler)
        begin("traffic")
        rows[0] |= {
            "detail": f"{plain:.3g} s when not profiled",
            "seconds_plain": plain,
            "voxels": made.n_voxels,
            "traffic": _traffic(made.laplace, spec.options["largest_copy"]),
        }
        return rows

    def below(self, rows: Sequence[Mapping[str, Any]], folder: Path) -> list[str]:
        """A picture and the account per case."""
        from ttus_opt.benchmark.flame import flame_graph
        from ttus_opt.report.plots.canvas import save_picture

        lines = []
        measured = [row for row in rows if row["status"] == MEASURED]
        for case in dict.fromkeys(row["case"] for row in measured):
            own = [row for row in measured if row["case"] == case]
            picture = f"profile-{case}.png"
            save_picture(flame_graph(own), folder / picture)
            title = f"Time of a fit, case {case}"
            lines += [f"### {title}", "", f"![{title}]({picture})", ""]
            lines += account.lines(own)
        return lines


def _fitted(
    case: CaseSpec,
    profiler: Profiler,
    time_limit: float,
    watches: Sequence[Watch] = (),
) -> Scene:
    """Build and fit; the scene with what it keeps.

    Raises:
        InputError: The fit was not solved: its profile is of no use.
    """
    read = case.build()
    with profiler.watched(watches), profiler.span(name.FIT):
        with profiler.span(name.ASSEMBLY):
            made = Scene.assemble(
                read.voxmap,
                read.shell,
                read.trajectory,
                inner=case.inner,
                outer=case.outer,
                sampling=case.sampling,
            )
            declared = shelf.load("eq10", made, **WEIGHTS)
        request = Request(TOLERANCE, time_limit)
        solution = Fitter(declared, solver=Structured.name, request=request).solve()
    if solution.verified_field is None:
        raise InputError(f"nothing to profile: {solution.advice}")
    return made


def _rows(profiler: Profiler) -> list[Figures]:
    nodes = profiler.nodes()
    whole = nodes[0].total
    return [
        {
            "path": list(node.path),
            "calls": node.calls,
            "total": node.total,
            "own": node.own,
            "ratio_to_fit": node.total / whole,
            "own_share": node.own / whole,
        }
        for node in nodes
    ]


def _traffic(laplace: LaplaceSystem, largest_copy: int | None) -> Figures:
    """Bytes and seconds of a V-cycle and of a solve, and what the machine copies."""
    multigrid = laplace.multigrid
    counted = Traffic.of(multigrid.hierarchy, laplace.grid.n_voxels)
    b = np.where(
        laplace.free, np.random.default_rng(0).normal(size=laplace.L.shape[0]), 0.0
    )
    rough = multigrid.rough()
    voxels = np.flatnonzero(laplace.free)
    rough.b[rough.places(voxels)] = b[voxels]
    alone = []
    for _ in range(CYCLES):
        start = time.perf_counter()
        rough.run()
        alone.append(time.perf_counter() - start)
    profiler, taken = Profiler(), []
    for _ in range(SOLVES):
        start = time.perf_counter()
        found = multigrid.solve(b, rtol=RTOL)
        taken.append(time.perf_counter() - start)
    with profiler.watched([Watch(Vectors, "correct", name.CORRECTION)]):
        multigrid.solve(b, rtol=RTOL)
    corrections = sum(node.calls for node in profiler.nodes())
    speed = Bandwidth.measure(counted.level, largest_copy)
    return {
        "bytes_once": counted.once,
        "bytes_cycle": counted.cycle,
        "bytes_finest": counted.finest,
        "bytes_vectors": counted.vectors,
        "bytes_correction": counted.correction,
        "bytes_level": counted.level,
        "bytes_solve": counted.solve(found.iterations, corrections),
        "cycles": found.iterations,
        "corrections": corrections,
        "seconds_cycle": statistics.median(alone),
        "seconds_solve": statistics.median(taken),
        "bandwidth_memory": speed.memory,
        "bandwidth_level": speed.level,
        "memory_size": speed.memory_size,
        "cache": speed.cache,
    }


PART = ProfilePart()

"""Part ``profile``: a profile of one fit, and a roofline of its multigrid."""

from __future__ import annotations

import cProfile
import time
from collections.abc import Sequence
from pathlib import Path
from types import CodeType

import ttus_opt
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.parts.base import Column, Part
from ttus_opt.benchmark.progress import Progress
from ttus_opt.benchmark.roofline import roofline, summary
from ttus_opt.benchmark.row import MEASURED, WEIGHTS, Row, RunSpec
from ttus_opt.benchmark.summary import seconds
from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import Fitter
from ttus_opt.problem.formulation import load
from ttus_opt.report.document import Block, Heading, Text
from ttus_opt.solvers.base import Request

#: Least fraction of the fit's time for a function to be listed [–]
LISTED = 0.05

#: KKT tolerance of the fit, as in the solvers' part
TOLERANCE = 1e-6

PACKAGE = Path(ttus_opt.__file__).parent


class ProfilePart(Part):
    """One run per case: eq. 10 by `structured`."""

    name = "profile"
    title = "Where the time of a fit goes"
    legend = (
        "One fit of eq. 10 by `structured` once its files are read, from assembly to "
        "an answer verified, under Python's own profiler; compilation is done before. "
        "*Total* is a function with all it calls, *own* without. Functions are listed "
        f"that take {LISTED:.0%} and more, those of other packages by their own time. "
        "Profiling costs something itself: the first row also says what the same fit "
        "took without."
    )
    columns = (
        Column("function", "function"),
        Column("calls", "calls", lambda value: f"{value:,}"),
        Column("total [s]", "total", seconds),
        Column("[%]", "ratio_to_fit", lambda value: f"{100.0 * value:.1f}"),
        Column("own [s]", "own", seconds),
        Column("[%]", "own_share", lambda value: f"{100.0 * value:.1f}"),
    )

    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Fit without and with the profiler, then count bytes."""
        case = spec.scene_case
        begin("warm-up")
        small = case.small().build()
        _fit(small, case, spec.time_limit)
        roofline(small.laplace)
        for _ in range(2):  # the first also allocates the process's memory
            begin("scene")
            read = case.build()
            begin("fit")
            start = time.perf_counter()
            _fit(read, case, spec.time_limit)
            plain = time.perf_counter() - start
        begin("scene")
        read = case.build()
        begin("profiled fit")
        with cProfile.Profile() as profiler:
            made = _fit(read, case, spec.time_limit)
        profiler.dump_stats(begin.keep(_file(case.name)))
        rows = _rows(profiler)
        begin("roofline")
        rows[0] |= {
            "detail": f"{plain:.3g} s when not profiled",
            "seconds_plain": plain,
            "voxels": made.n_voxels,
            "roofline": roofline(made.laplace),
        }
        return rows

    def below(self, rows: Sequence[Row]) -> list[Block]:
        """The roofline summary of every case."""
        blocks: list[Block] = []
        for row in rows:
            if row["status"] == MEASURED and "roofline" in row:
                file, case = _file(row["case"]), row["case"]
                functions = f"All functions: [{file}]({file}), for `python -m pstats`."
                blocks.append(Heading(f"Roofline of multigrid, case {case}", 3))
                blocks += [*summary(row["roofline"]), Text(functions)]
        return blocks


def _file(case: str) -> str:
    return f"profile-{case}.prof"


def _fit(read: Scene, case: CaseSpec, time_limit: float) -> Scene:
    """Assemble and fit; `InputError` if the fit failed."""
    made = Scene.assemble(
        read.voxmap,
        read.shell,
        read.trajectory,
        inner=case.inner,
        outer=case.outer,
        sampling=case.sampling,
    )
    declared = load("eq10", made, **WEIGHTS)
    request = Request(TOLERANCE, time_limit)
    solution = Fitter(declared, solver="structured", request=request).solve()
    if solution.verified_field is None:
        raise InputError(f"nothing to profile: {solution.advice}")
    return made


def _rows(profiler: cProfile.Profile) -> list[Row]:
    """A row per listed function, largest first."""
    entries = sorted(profiler.getstats(), key=lambda e: e.totaltime, reverse=True)
    whole = next(e.totaltime for e in entries if e.code is _fit.__code__)
    rows = []
    for entry in entries:
        name, ours = _named(entry.code)
        if name.endswith(">"):  # a comprehension belongs to its function
            continue
        counted = entry.totaltime if ours else entry.inlinetime
        if LISTED * whole <= counted and entry.totaltime <= whole:
            rows.append(
                {
                    "function": name,
                    "calls": entry.callcount,
                    "total": entry.totaltime,
                    "own": entry.inlinetime,
                    "ratio_to_fit": entry.totaltime / whole,
                    "own_share": entry.inlinetime / whole,
                }
            )
    return rows


def _named(code: CodeType | str) -> tuple[str, bool]:
    """Module and name of a function, and whether it is this package's."""
    if isinstance(code, str):  # a built-in one
        return code.strip("<>"), False
    file = Path(code.co_filename)
    ours = file.is_relative_to(PACKAGE)
    parts = file.relative_to(PACKAGE).parts if ours else file.parts[-2:]
    return ".".join([*parts, code.co_qualname]).replace(".py.", "."), ours


PART = ProfilePart()

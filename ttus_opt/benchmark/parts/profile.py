"""Part ``profile``: a profile of one fit, and a roofline of its multigrid.

A roofline is the bytes moved against the measured bandwidth. Every pass of a V-cycle
streams over whole arrays and computes little, so that memory traffic bounds its time
from below (Williams, Waterman and Patterson 2009). Bytes are counted from the sizes of
the arrays, each once in every pass that touches it; a block of radial lines stays in
cache for both sweeps and counts once. The unit is one colour, red or black, of one
array of a level, in single precision.
"""

from __future__ import annotations

import cProfile
import math
import statistics
import time
from collections.abc import Sequence
from pathlib import Path
from types import CodeType

import numpy as np

import ttus_opt
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.machine import Progress, timed
from ttus_opt.benchmark.parts.base import Column, Part
from ttus_opt.benchmark.row import MEASURED, WEIGHTS, Row, RunSpec
from ttus_opt.benchmark.summary import seconds
from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import Fitter
from ttus_opt.laplace.multigrid import Multigrid
from ttus_opt.laplace.multigrid.solver import REDUCTION
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.formulation import load
from ttus_opt.report.document import Block, Heading, Table, Text
from ttus_opt.solvers.base import Request

#: Colours of arrays that a V-cycle streams on the finest level: four sweeps of a colour
#: (3, 3, 3, 4: right side, inverse pivots, both colours of x; the right side of one is
#: zero), residual (3), restriction (3) and prolongation (4) with one array of weights;
#: an odd number of spokes needs a few more
FINEST = 23

#: On a coarser level: eight sweeps of a colour (9 each: conductances R, both colours
#: of T and Z, too; the first, with nothing opposite yet, 4), two residuals (6, 7),
#: transfers of six weights (7, 8)
COARSER = 95

#: Restriction and prolongation on the level below: b and x, both colours
BELOW = 4

#: Conjugate gradients around a V-cycle: r·z, p, A p, x and r, of one colour
GRADIENTS = 18

#: Relative residual of a solve, as in fits [–]
RTOL = 1e-12

#: Repetitions of a solve, a V-cycle and a copy
SOLVES, CYCLES, COPIES = 3, 20, 30


def roofline(laplace: LaplaceSystem) -> Row:
    """Bytes and seconds of a V-cycle and of a solve with A, and a copy's bandwidth.

    Returns:
        ``bytes_level`` (one array of the finest level), ``bytes_cycle`` and
        ``bytes_solve`` (residuals in double precision included) [byte], ``cycles`` of
        the solve [–], ``seconds_cycle`` and ``seconds_solve`` (medians) [s],
        ``bandwidth``: bytes read and written per second by the fastest of several
        copies of an array of ``bytes_level``.
    """
    multigrid = laplace.multigrid
    level, cycle = cycle_bytes(multigrid)
    b = np.random.default_rng(0).normal(size=laplace.L.shape[0])
    b = np.where(laplace.free, b, 0.0)
    cycles = multigrid.solve(b, rtol=RTOL).iterations
    # a round of refinement in double precision: x read twice and written, b, the mask,
    # and single precision both ways; it leaves `REDUCTION` of the residual
    rounds = math.ceil(math.log(RTOL) / math.log(REDUCTION))
    refinement = b.size * (4 * 8 + 1) + 6 * level
    one = multigrid.preconditioner()
    voxels = np.flatnonzero(laplace.free)
    one.b[one.places(voxels)] = b[voxels]
    source, target = np.ones(level // 8), np.empty(level // 8)
    solving = timed(lambda: multigrid.solve(b, rtol=RTOL), SOLVES)
    copying = timed(lambda: np.copyto(target, source), COPIES)
    return {
        "bytes_level": level,
        "bytes_cycle": cycle,
        "bytes_solve": cycles * (cycle + GRADIENTS * level // 2) + rounds * refinement,
        "cycles": cycles,
        "seconds_cycle": statistics.median(timed(one.run, CYCLES)),
        "seconds_solve": statistics.median(solving),
        "bandwidth": 2.0 * source.nbytes / min(copying),
    }


def cycle_bytes(multigrid: Multigrid) -> tuple[int, int]:
    """Bytes of one array of the finest level, and bytes that a V-cycle streams."""
    hierarchy = multigrid.hierarchy
    sizes = [level.inverse.nbytes for level in hierarchy.levels]  # both colours
    colours = FINEST * sizes[0] + COARSER * sum(sizes[1:-1]) + BELOW * sum(sizes[1:])
    return sizes[0], colours // 2 + hierarchy.inverse.nbytes


def summary(row: Row) -> list[Block]:
    """The result of `roofline`."""
    header = ["", "bytes [MB]", "copying them [ms]", "measured [ms]", "of the limit"]
    body = []
    for name, work in (
        ("cycle", "V-cycle"),
        ("solve", f"solve with A: {row['cycles']} V-cycles"),
    ):
        moved, taken = row[f"bytes_{name}"], row[f"seconds_{name}"]
        limit = moved / row["bandwidth"]
        figures = f"{moved / 1e6:.3g}", f"{1e3 * limit:.3g}", f"{1e3 * taken:.3g}"
        body.append([work, *figures, f"{limit / taken:.0%}"])
    return [
        Text(
            "A copy on one core, reads and writes counted, runs at "
            f"{row['bandwidth'] / 1e9:.1f} GB/s for an array of "
            f"{row['bytes_level'] / 1e6:.2g} MB, the size of the finest level's."
        ),
        Table(header, body),
    ]


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
        small = case.small().scene()
        _fit(small, case, spec.time_limit)
        roofline(small.laplace)
        for _ in range(2):  # the first also allocates the process's memory
            begin("scene")
            read = case.scene()
            begin("fit")
            start = time.perf_counter()
            _fit(read, case, spec.time_limit)
            plain = time.perf_counter() - start
        begin("scene")
        read = case.scene()
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

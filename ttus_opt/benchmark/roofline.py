"""Roofline summary of multigrid: bytes moved against the measured bandwidth.

Every pass of a V-cycle streams over whole arrays and computes little, so that memory
traffic bounds its time from below (Williams, Waterman and Patterson 2009). Bytes are
counted from the sizes of the arrays, each once in every pass that touches it; a block
of radial lines stays in cache for both sweeps and counts once. The unit is one colour,
red or black, of one array of a level, in single precision.
"""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable

import numpy as np

from ttus_opt.benchmark.row import Row
from ttus_opt.laplace.multigrid import Multigrid
from ttus_opt.laplace.multigrid.solver import REDUCTION
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.report.document import Block, Table, Text

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
    solving = _seconds(lambda: multigrid.solve(b, rtol=RTOL), SOLVES)
    copying = _seconds(lambda: np.copyto(target, source), COPIES)
    return {
        "bytes_level": level,
        "bytes_cycle": cycle,
        "bytes_solve": cycles * (cycle + GRADIENTS * level // 2) + rounds * refinement,
        "cycles": cycles,
        "seconds_cycle": statistics.median(_seconds(one.run, CYCLES)),
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


def _seconds(work: Callable[[], object], count: int) -> list[float]:
    taken = []
    for _ in range(count):
        start = time.perf_counter()
        work()
        taken.append(time.perf_counter() - start)
    return taken

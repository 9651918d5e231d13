"""Part ``assembly``: seconds and memory of L and b, and of N and W."""

from __future__ import annotations

import gc
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, get_args

from ttus_opt.benchmark import memory
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.parts.base import (
    SHELL_POINTS,
    Column,
    Figures,
    Part,
    PartSpec,
    scene_case,
)
from ttus_opt.benchmark.plain_assembly import plain_laplace, plain_rows
from ttus_opt.benchmark.stages import Stages
from ttus_opt.benchmark.summary import mebibytes, number, seconds, times
from ttus_opt.contact.rows import Sampling, contact_rows
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.scene import Scene

#: How many times each stage is timed
REPEATS = 3

#: Boundary values of the case where these are to be fitted; they decide no time
BOUNDARY = 1.0

Matrices = tuple[Any, ...]


class AssemblyPart(Part):
    """One run per case, its own stages and the plain ones in the same process."""

    name = "assembly"
    title = "Assembly of L, b, N and W"
    legend = (
        f"The case with its poses and a shell of {SHELL_POINTS:,} points; median of "
        f"{REPEATS}. *Plain* is the same written with scipy's Kronecker products (L, "
        "b) or whole-array numpy pose by pose (N, W), in the same process. *Peak* is "
        "the largest size of the process during the stage, *added* what the stage "
        "added to it at most, result included. *Difference* is the largest of any "
        "entry, over the largest entry."
    )
    columns = (
        Column("stage", "stage"),
        Column("sampling", "sampling"),
        Column("time [s]", "seconds", seconds),
        Column("plain [s]", "seconds_plain", seconds),
        Column("to plain", "ratio_to_plain", times),
        Column("peak [MiB]", "peak_memory_bytes", mebibytes),
        Column("added [MiB]", "added_memory_bytes", mebibytes),
        Column("plain added", "added_memory_bytes_plain", mebibytes),
        Column("difference", "largest_difference", number),
    )

    def plan(self, cases: Sequence[CaseSpec], time_limit: float) -> list[PartSpec]:
        """Every case with the larger shell."""
        return [
            PartSpec(
                self.name,
                replace(case, n_points=SHELL_POINTS, inner=_boundary(case)),
                {"repeats": REPEATS},
                time_limit,
            )
            for case in cases
        ]

    def measure(self, spec: PartSpec, begin: Stages) -> list[Figures]:
        """Time and weigh every stage."""
        case = scene_case(spec)
        begin("warm-up")
        _measured(case.small(), 1, lambda stage: None)
        return _measured(case, int(spec.options["repeats"]), begin)


def _boundary(case: CaseSpec) -> float:
    return BOUNDARY if isinstance(case.inner, str) else case.inner


def _measured(
    case: CaseSpec, repeats: int, begin: Callable[[str], None]
) -> list[Figures]:
    begin("scene")
    scene = case.build()
    voxmap, poses = scene.voxmap, scene.trajectory
    size = {
        "voxels": scene.n_voxels,
        "poses": len(poses),
        "points": len(scene.shell),
    }
    inner, outer = scene.inner, scene.outer

    def laplace() -> Matrices:
        made = LaplaceSystem.assemble(voxmap)
        return made.L, made.right_side(inner, outer)

    rows = [
        _stage(
            "L, b",
            laplace,
            lambda: plain_laplace(voxmap, inner, outer),
            repeats,
            begin,
        )
    ]
    for sampling in get_args(Sampling):
        ours, plain = _row_makers(scene, scene.shell, sampling)
        rows.append(
            _stage(f"N, W {sampling}", ours, plain, repeats, begin)
            | {"stage": "N, W", "sampling": sampling}
        )
    return [size | row for row in rows]


def _row_makers(
    scene: Scene, shell: PointShell, sampling: str
) -> tuple[Callable[[], Matrices], Callable[[], Matrices]]:
    """Makers of N and W: ours and the plain one."""
    voxmap, poses = scene.voxmap, scene.trajectory

    def ours() -> Matrices:
        made = contact_rows(
            voxmap, shell, poses.rotation, poses.position, sampling=sampling
        )
        return made.N, made.W

    def plain() -> Matrices:
        return plain_rows(voxmap, shell, poses.rotation, poses.position, sampling)

    return ours, plain


def _stage(
    name: str,
    ours: Callable[[], Matrices],
    plain: Callable[[], Matrices],
    repeats: int,
    begin: Callable[[str], None],
) -> Figures:
    """One row: a stage and its reference, timed and weighed."""
    begin(name)
    made, taken, peak, added = _weighed(ours, repeats)
    begin(f"{name}, plain")
    other, plain_taken, _, plain_added = _weighed(plain, repeats)
    begin(f"{name}, comparison")
    return {
        "stage": name,
        "seconds": taken,
        "seconds_plain": plain_taken,
        "ratio_to_plain": taken / plain_taken,
        "peak_memory_bytes": peak,
        "added_memory_bytes": added,
        "added_memory_bytes_plain": plain_added,
        "largest_difference": max(map(_apart, made, other)),
    }


def _weighed(
    make: Callable[[], Matrices], repeats: int
) -> tuple[Matrices, float, int, int]:
    """What was made, median seconds, and the first making's peak and growth [byte]."""
    taken, before, peak, added = [], 0, 0, 0
    for n in range(repeats):
        made: Matrices = ()
        if n == 0:
            gc.collect()
            memory.trim()
            before = memory.current_bytes()
            memory.reset_peak()
        start = time.perf_counter()
        made = make()
        taken.append(time.perf_counter() - start)
        if n == 0:  # later ones take pages again that the first left behind
            peak = memory.peak_bytes()
            added = max(0, peak - before)
    return made, statistics.median(taken), peak, added


def _apart(a: Any, b: Any) -> float:
    """Largest difference of any entry over the largest entry."""
    size, difference = float(abs(a).max()), float(abs(a - b).max())
    return difference / size if size else difference


PART = AssemblyPart()

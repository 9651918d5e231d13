"""Part ``assembly``: seconds and memory of L and b, and of N and W."""

from __future__ import annotations

import gc
import statistics
from collections.abc import Callable
from dataclasses import replace
from typing import ClassVar, get_args

from ttus_opt.benchmark import machine
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import SHELL_POINTS, Column, Part
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.benchmark.summary import mebibytes, seconds
from ttus_opt.contact.rows import Sampling, contact_rows
from ttus_opt.laplace.system import LaplaceSystem

#: Repetitions of each stage
REPEATS = 3

#: Boundary values instead of fitted ones; they do not affect the time
BOUNDARY = 1.0


class AssemblyPart(Part):
    """One run per case."""

    name = "assembly"
    title = "Assembly of L, b, N and W"
    legend = (
        f"The case with its poses and a shell of {SHELL_POINTS:,} points; median of "
        f"{REPEATS}. *Peak* is the largest size of the process during the stage, "
        "*added* what the stage added to it at most, result included."
    )
    columns = (
        Column("stage", "stage"),
        Column("sampling", "sampling"),
        Column("time [s]", "seconds", seconds),
        Column("peak [MiB]", "peak_memory_bytes", mebibytes),
        Column("added [MiB]", "added_memory_bytes", mebibytes),
    )

    options: ClassVar = {"repeats": REPEATS}

    def prepared(self, case: CaseSpec) -> CaseSpec:
        """The case with the larger shell and given boundary values."""
        inner = BOUNDARY if isinstance(case.inner, str) else case.inner
        return replace(case, n_points=SHELL_POINTS, inner=inner)

    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Measure time and memory of every stage."""
        begin("warm-up")
        _measured(spec.scene_case.small(), 1, lambda stage: None)
        return _measured(spec.scene_case, int(spec.options["repeats"]), begin)


def _measured(case: CaseSpec, repeats: int, begin: Callable[[str], None]) -> list[Row]:
    begin("scene")
    scene = case.scene()
    voxmap, poses = scene.voxmap, scene.trajectory
    size = {"voxels": scene.n_voxels, "poses": len(poses), "points": len(scene.shell)}

    def laplace() -> object:
        made = LaplaceSystem.assemble(voxmap)
        return made, made.right_side(scene.inner, scene.outer)

    begin("L, b")
    rows = [size | {"stage": "L, b"} | _timed(laplace, repeats)]
    for sampling in get_args(Sampling):

        def contact(sampling: Sampling = sampling) -> object:
            return contact_rows(
                voxmap, scene.shell, poses.rotation, poses.position, sampling=sampling
            )

        begin(f"N, W {sampling}")
        stage = {"stage": "N, W", "sampling": sampling}
        rows.append(size | stage | _timed(contact, repeats))
    return rows


def _timed(make: Callable[[], object], repeats: int) -> Row:
    """Median seconds, and peak and growth of memory of the first call."""
    gc.collect()
    machine.trim()
    before = machine.resident_bytes()
    machine.reset_peak()
    taken = machine.timed(make, 1)
    peak = machine.peak_bytes()  # later calls reuse freed pages
    taken += machine.timed(make, repeats - 1)
    return {
        "seconds": statistics.median(taken),
        "peak_memory_bytes": peak,
        "added_memory_bytes": max(0, peak - before),
    }


PART = AssemblyPart()

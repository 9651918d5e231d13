"""Part ``recursion``: time per update of the recursive fit, against batch fits."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from ttus_opt.benchmark import machine
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import Column, Part
from ttus_opt.benchmark.row import WEIGHTS, Row, RunSpec
from ttus_opt.benchmark.summary import mebibytes, number, seconds, times
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import Fitter
from ttus_opt.fitting.recursion.recursive import RecursiveFit
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.solvers.base import Request

#: Number of updates, and of those after which the field is compared with a batch fit
UPDATES, COMPARED = 1200, 400

#: Updates in the first and in the last reported window
WINDOW = 50

#: Repetitions of the batch fits
REPEATS = 3

#: Displacement of poses that are repeated if the recordings are too short [m]
MOVED = 1e-3

#: KKT tolerance of the timed batch fit, as in the solvers' part, and of the reference
TIMED, TIGHT = 1e-6, 1e-9


class RecursionPart(Part):
    """One run per case."""

    name = "recursion"
    title = "One measurement at a time"
    legend = (
        f"`RecursiveFit` takes in up to {UPDATES:,} measurements that touch the "
        "patient, one by one; if the recordings have fewer, poses are taken again "
        f"{1e3 * MOVED:g} mm aside. Seconds per update, contact rows included, over "
        f"the first and the last {WINDOW}, the latter with the number held; *field* "
        "is the current field, asked for after each of the last. *Batch "
        "first* is `structured` on as many measurements, set-up included, *again* "
        "the same fitter given one measurement more; both without contact rows. "
        f"Difference is that of the field after {COMPARED} updates from the batch "
        f"fit's with a tolerance of {TIGHT:g}, relative to the field; both use the "
        "same solves with L, whose error it does not show. *Data* is what the "
        "measurements changed the field by, on the same scale."
    )
    columns = (
        Column("held", "held", lambda value: f"{value:,}"),
        Column("early: median [s]", "early_median", seconds),
        Column("max", "early_max", seconds),
        Column("late: median [s]", "late_median", seconds),
        Column("max", "late_max", seconds),
        Column("field: median [s]", "field_median", seconds),
        Column("max", "field_max", seconds),
        Column("batch first [s]", "batch_first", seconds),
        Column("again", "batch_again", seconds),
        Column("late to first", "ratio_to_batch_first", times),
        Column("to again", "ratio_to_batch_again", times),
        Column("peak [MiB]", "peak_memory_bytes", mebibytes),
        Column("difference", "difference_from_batch", number),
        Column("data", "change_from_prior", number),
    )

    options: ClassVar = {"updates": UPDATES, "compared": COMPARED}

    def prepared(self, case: CaseSpec) -> CaseSpec:
        """The case with all frames of its recordings."""
        return replace(case, n_poses=None)

    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Update recursively, then fit the same measurements in a batch."""
        begin("warm-up")
        _warm_up(spec.scene_case)
        begin("scene")
        whole = spec.scene_case.scene()
        updates, compared = int(spec.options["updates"]), int(spec.options["compared"])
        scene = with_measurements(whole, _touching(whole, updates))
        begin("updates")
        # updates stop at the time limit, keeping what was measured
        taken, made, fields = _updated(scene, {compared}, spec.time_limit)
        peak = machine.peak_bytes()
        held = len(taken)
        row = _typical("early", taken[:WINDOW]) | _typical("late", taken[-WINDOW:])
        row |= _typical("field", made) | {
            "voxels": scene.n_voxels,
            "updates_asked": updates,
            "held": held,
            "peak_memory_bytes": peak,
            "detail": ""
            if held == updates
            else f"stopped after {held:,} of {updates:,} updates by the time limit",
        }
        if held > 1:
            first, again = _batch(scene, held, begin)
            late = row["late_median"]
            row |= {
                "batch_first": first,
                "batch_again": again,
                "ratio_to_batch_first": late / first,
                "ratio_to_batch_again": late / again,
            }
        if fields:
            begin("comparison")
            row |= _compared(scene, compared, *fields)
        return [row]


def with_measurements(scene: Scene, trajectory: Trajectory) -> Scene:
    """The scene with another recording; Laplace system and b are shared."""
    return replace(scene, trajectory=trajectory, rows=scene.rows_along(trajectory))


def _touching(scene: Scene, count: int) -> Trajectory:
    """``count`` measurements in contact, the recordings' own first."""
    recorded = _in_contact(scene)
    if len(recorded) == 0:
        raise InputError("no pose touches the patient: give recordings in contact")
    rng = np.random.default_rng(0)
    parts, total = [recorded], len(recorded)
    while total < count:
        moved = recorded.position + rng.normal(0.0, MOVED, recorded.position.shape)
        more = _in_contact(with_measurements(scene, replace(recorded, position=moved)))
        parts.append(more)
        total += len(more)
    return Trajectory.concatenate(parts).select(np.arange(count))


def _in_contact(scene: Scene) -> Trajectory:
    touching = np.flatnonzero(scene.touching)
    return scene.trajectory.select(touching)


def _updated(
    scene: Scene, wanted: set[int], budget: float
) -> tuple[list[float], list[float], list[Array]]:
    """Seconds of every update and of the last fields, and the fields wanted."""
    poses = scene.trajectory
    if poses.force is None or poses.torque is None:
        raise InputError("the recursion needs measured forces and torques")
    size = len(poses)
    fit = RecursiveFit(
        scene, **WEIGHTS, capacity=size, outlier_level=None, fold_scene=False
    )
    taken: list[float] = []
    made: list[float] = []
    fields = []
    begun = time.perf_counter()
    frames = zip(poses.rotation, poses.position, poses.force, poses.torque, strict=True)
    for measurement in frames:
        start = time.perf_counter()
        fit.update(*measurement)
        taken.append(time.perf_counter() - start)
        if len(taken) > size - WINDOW:
            start = time.perf_counter()
            _ = fit.field
            made.append(time.perf_counter() - start)
        if len(taken) in wanted:
            fields.append(fit.field.values.reshape(-1).copy())
        if time.perf_counter() - begun > budget:
            break
    return taken, made, fields


def _typical(name: str, taken: Sequence[float]) -> Row:
    """Median and maximum of times, if any [s]."""
    if not taken:
        return {}
    return {f"{name}_median": statistics.median(taken), f"{name}_max": max(taken)}


def _eq10(scene: Scene, count: int) -> Formulation:
    """Eq. 10 on the first measurements."""
    part = scene.trajectory.select(np.arange(count))
    return load("eq10", with_measurements(scene, part), **WEIGHTS)


def _batch(
    scene: Scene, count: int, begin: Callable[[str], None]
) -> tuple[float, float]:
    """Median seconds of `structured` on all but the last measurement, then on all."""
    first, again = [], []
    for _ in range(REPEATS):
        # a copy, because a Laplace system caches its multigrid, which is set-up
        copy = replace(scene, laplace=replace(scene.laplace))
        before, whole = _eq10(copy, count - 1), _eq10(copy, count)
        for each in (before, whole):
            each.compile()
        begin("batch first")
        fitter = Fitter(before, solver="structured", request=Request(TIMED))
        timings = fitter.solve().timings
        first.append(timings.setup + timings.solve)
        begin("batch again")
        fitter.update(whole)
        again.append(fitter.solve().timings.again or 0.0)
    return statistics.median(first), statistics.median(again)


def _compared(scene: Scene, count: int, field: Array) -> Row:
    """The recursive field compared with the batch fit's and the prior."""
    fitter = Fitter(_eq10(scene, count), solver="structured", request=Request(TIGHT))
    p = fitter.solve().variables["p"]
    prior = scene.laplace.solve(scene.b)
    size = np.linalg.norm(p)
    return {
        "compared_at": count,
        "difference_from_batch": float(np.linalg.norm(field - p) / size),
        "change_from_prior": float(np.linalg.norm(p - prior) / size),
    }


def _warm_up(case: CaseSpec) -> None:
    """Import and compile before the measurement."""
    small = replace(case.small(), n_poses=24).scene()
    scene = with_measurements(small, _touching(small, 4))
    _updated(scene, {2}, 60.0)
    _batch(scene, 4, lambda stage: None)


PART = RecursionPart()

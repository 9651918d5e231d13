"""Part ``recursion``: seconds per update of the recursive fit, against fitting anew."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import ClassVar

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.benchmark import memory
from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.parts.base import Column, Part
from ttus_opt.benchmark.progress import Progress
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.benchmark.settings import WEIGHTS
from ttus_opt.benchmark.summary import mebibytes, number, seconds, times
from ttus_opt.errors import InputError
from ttus_opt.fitting.batch import Fitter
from ttus_opt.fitting.recursive import RecursiveFit
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import Scene
from ttus_opt.solvers.base import Request

#: Measurements folded in, and after how many the field is compared with the batch's
UPDATES, COMPARED = 1200, 400

#: Updates in the first and in the last window that are reported
WINDOW = 50

#: How many times the batch fits are timed
REPEATS = 3

#: Where the recordings are too short, poses are taken again, moved by so much [m]
MOVED = 1e-3

#: KKT tolerance of the batch fit that is timed, as the solvers' rows have it, and of
#: the one that is compared with
TIMED, TIGHT = 1e-6, 1e-9


class RecursionPart(Part):
    """One run per case."""

    name = "recursion"
    title = "One measurement at a time"
    legend = (
        f"`RecursiveFit` takes in up to {UPDATES:,} measurements that touch the "
        "patient, one by one; where the recordings have fewer, poses are taken again "
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
        """Fold in, then fit the same measurements at once."""
        begin("warm-up")
        _warm_up(spec.scene_case)
        begin("scene")
        whole = spec.scene_case.build()
        updates, compared = int(spec.options["updates"]), int(spec.options["compared"])
        scene = with_measurements(whole, _touching(whole, updates))
        begin("updates")
        # updates have the time limit as their budget, to end with what there is
        taken, made, fields = _folded(scene, {compared}, spec.time_limit)
        peak = memory.peak_bytes()
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
    """As many measurements in contact as asked for, the recordings' own first."""
    own = _in_contact(scene)
    if len(own) == 0:
        raise InputError("no pose touches the patient: give recordings in contact")
    rng = np.random.default_rng(0)
    parts, found = [own], len(own)
    while found < count:
        moved = own.position + rng.normal(0.0, MOVED, own.position.shape)
        more = _in_contact(with_measurements(scene, replace(own, position=moved)))
        parts.append(more)
        found += len(more)
    return Trajectory.concatenate(parts).select(np.arange(count))


def _in_contact(scene: Scene) -> Trajectory:
    touching = np.flatnonzero(scene.rows.contact_points > 0)
    return scene.trajectory.select(touching)


def _folded(
    scene: Scene, wanted: set[int], budget: float
) -> tuple[list[float], list[float], list[Array]]:
    """Seconds of every update and of the last fields, and the fields wanted."""
    told = scene.trajectory
    if told.force is None or told.torque is None:
        raise InputError("the recursion needs measured forces and torques")
    fit = RecursiveFit(
        scene,
        **WEIGHTS,
        capacity=len(told),
        outlier_level=None,
        fold_scene=False,
    )
    taken: list[float] = []
    made: list[float] = []
    fields = []
    begun = time.perf_counter()
    measured = zip(told.rotation, told.position, told.force, told.torque, strict=True)
    for measurement in measured:
        start = time.perf_counter()
        fit.update(*measurement)
        taken.append(time.perf_counter() - start)
        if len(taken) > len(told) - WINDOW:
            start = time.perf_counter()
            _ = fit.field
            made.append(time.perf_counter() - start)
        if len(taken) in wanted:
            fields.append(fit.field.values.reshape(-1).copy())
        if time.perf_counter() - begun > budget:
            break
    return taken, made, fields


def _typical(name: str, taken: Sequence[float]) -> Row:
    """Median and maximum of some times, where there are any [s]."""
    if not taken:
        return {}
    return {f"{name}_median": statistics.median(taken), f"{name}_max": max(taken)}


def _eq10(scene: Scene, count: int) -> Formulation:
    """Eq. 10 on the first measurements."""
    part = scene.trajectory.select(np.arange(count))
    return shelf.load("eq10", with_measurements(scene, part), **WEIGHTS)


def _batch(
    scene: Scene, count: int, begin: Callable[[str], None]
) -> tuple[float, float]:
    """Median seconds of `structured` on all but the last measurement, then on all."""
    first, again = [], []
    for _ in range(REPEATS):
        # a Laplace system makes its multigrid once: a copy, so that set-up has it
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
    """The field after so many measurements beside the batch fit's and the prior."""
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
    """Imports and compilation are no part of what is measured."""
    small = replace(case.small(), n_poses=24).build()
    scene = with_measurements(small, _touching(small, 4))
    _folded(scene, {2}, 60.0)
    _batch(scene, 4, lambda stage: None)


PART = RecursionPart()

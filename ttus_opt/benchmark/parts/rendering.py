"""Part ``rendering``: time of a haptic frame against whole-array numpy."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import replace
from typing import get_args

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.parts.base import (
    SHELL_POINTS,
    Column,
    Figures,
    Part,
    PartSpec,
    scene_case,
)
from ttus_opt.benchmark.rendering import FrameTimes, RenderingFigures, time_rendering
from ttus_opt.benchmark.stages import Stages
from ttus_opt.benchmark.summary import times
from ttus_opt.contact.rows import Sampling
from ttus_opt.errors import InputError
from ttus_opt.scene import Scene
from ttus_opt.voxmap.field import PotentialField

#: Times every pose is rendered
PASSES = 50

#: Ways to render: their name in the table, and in `RenderingFigures`
WAYS = {
    "numpy": "numpy",
    "compiled loop over all points": "loop",
    "render, back to back": "renderer",
    "render, amid a swap of fields": "blending",
    "render_into, back to back": "into",
    "render_into, paced": "paced",
}


def _microseconds(value: float) -> str:
    return f"{1e6 * value:,.0f}" if value >= 1e-4 else f"{1e6 * value:.3g}"


class RenderingPart(Part):
    """One run per case and sampling; the field is the Laplace field."""

    name = "rendering"
    title = "Time of a haptic frame"
    legend = (
        "Wall time per frame over the case's poses, percentiles as a haptic loop sees "
        "them, other programs included; *own* is the frame's processor time, least of "
        "several passes, median over the poses. *Paced* sleeps 1 ms between frames. "
        "It and numpy have a tenth of the others' frames. "
        "Ratios are of medians, to whole-array numpy in the same run."
    )
    columns = (
        Column("sampling", "sampling"),
        Column("way", "way"),
        Column("median [µs]", "median", _microseconds),
        Column("99 %", "percentile_99", _microseconds),
        Column("99.9 %", "percentile_99_9", _microseconds),
        Column("max", "longest", _microseconds),
        Column("own", "processor", _microseconds),
        Column("to numpy", "ratio_to_numpy", times),
    )

    def plan(self, cases: Sequence[CaseSpec], time_limit: float) -> list[PartSpec]:
        """Both samplings of every case."""
        return [
            PartSpec(
                self.name,
                replace(case, sampling=sampling, n_points=SHELL_POINTS),
                {"passes": PASSES, "sampling": sampling},
                time_limit,
            )
            for case in cases
            for sampling in get_args(Sampling)
        ]

    def measure(self, spec: PartSpec, begin: Stages) -> list[Figures]:
        """Time all ways over the case's poses."""
        case = scene_case(spec)
        begin("warm-up")
        with contextlib.suppress(InputError):  # none of its few poses need touch
            _timed(*_rendered(case.small()), passes=1)
        begin("scene")
        scene, field = _rendered(case)
        begin("frames")
        return _rows(_timed(scene, field, passes=int(spec.options["passes"])))


def _rendered(case: CaseSpec) -> tuple[Scene, PotentialField]:
    """A scene and its Laplace field."""
    scene = case.build()
    values = scene.voxmap.grid.unflatten(scene.laplace.solve(scene.b))
    return scene, PotentialField(scene.voxmap, values, scene.sampling)


def _timed(scene: Scene, field: PotentialField, *, passes: int) -> RenderingFigures:
    poses = scene.trajectory
    return time_rendering(
        field, scene.shell, poses.rotation, poses.position, passes=passes
    )


def _rows(figures: RenderingFigures) -> list[Figures]:
    rows = []
    for way, name in WAYS.items():
        frame: FrameTimes = getattr(figures, name)
        rows.append(
            {
                "sampling": figures.sampling,
                "way": way,
                "median": frame.median,
                "percentile_99": frame.percentile_99,
                "percentile_99_9": frame.percentile_99_9,
                "longest": frame.longest,
                "processor": frame.processor,
                "processor_99_9": frame.processor_99_9,
                "ratio_to_numpy": frame.median / figures.numpy.median,
                "points": figures.n_points,
                "contact_points": figures.contact_points,
                "renderer_frames": figures.frames,
                "bytes_per_frame": figures.bytes_per_frame,
                "largest_difference": figures.largest_difference,
                "load": figures.load,
            }
        )
    return rows


PART = RenderingPart()

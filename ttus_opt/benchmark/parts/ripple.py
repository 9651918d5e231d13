"""Part ``ripple``: how far the voxels show through in the force of a sliding probe."""

from __future__ import annotations

from collections.abc import Sequence
from typing import get_args

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.parts.base import Column, Figures, Part, PartSpec
from ttus_opt.benchmark.ripple import Direction, ripple
from ttus_opt.benchmark.stages import Stages
from ttus_opt.benchmark.summary import times
from ttus_opt.contact.rows import Sampling

#: Steps of the grid [m]
VOXELS = (0.001, 0.002, 0.004)


class RipplePart(Part):
    """Both samplings and directions, one run per voxel size."""

    name = "ripple"
    title = "Ripple of the force in a slide"
    legend = (
        "A probe slides at constant depth where nothing changes, so that the force "
        "should not either: peak to peak over mean of its magnitude. The ratio is to "
        "`voxel-mean` with the same voxels and direction. The slide brings its own "
        "cylinder and takes no case."
    )
    columns = (
        Column("voxel [mm]", "voxel", lambda value: f"{1e3 * value:g}"),
        Column("direction", "direction"),
        Column("sampling", "sampling"),
        Column("ripple [%]", "ripple", lambda value: f"{100.0 * value:.3g}"),
        Column("to voxel-mean", "ratio_to_voxel_mean", times),
    )

    def plan(self, cases: Sequence[CaseSpec], time_limit: float) -> list[PartSpec]:
        """One run per voxel size, whatever the cases are."""
        return [
            PartSpec(self.name, None, {"voxel": voxel}, time_limit) for voxel in VOXELS
        ]

    def measure(self, spec: PartSpec, begin: Stages) -> list[Figures]:
        """Slide in both directions with both samplings."""
        rows = []
        for direction in get_args(Direction):
            reference = 0.0
            for sampling in get_args(Sampling):
                begin(f"{sampling} {direction}")
                found = ripple(sampling, direction=direction, **spec.options)
                if sampling == "voxel-mean":
                    reference = found.ripple
                rows.append(
                    {
                        "voxel": found.voxel,
                        "direction": direction,
                        "sampling": sampling,
                        "depth": found.depth,
                        "mean_force": found.mean_force,
                        "ripple": found.ripple,
                        "ratio_to_voxel_mean": found.ripple / reference,
                    }
                )
        return rows


PART = RipplePart()

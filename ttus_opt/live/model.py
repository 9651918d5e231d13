"""The model of a live session: a patient, a probe, and what was learned of them."""

from __future__ import annotations

import copy
from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.fitting.recursion.recursive_depth_map import (
    DepthMapState,
    Folded,
    RecursiveDepthMap,
)
from ttus_opt.live.messages import Sample
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.problem.terms.depth_profile import DepthProfile
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap

#: Longest time between samples whose difference is a velocity [s]
LONGEST_STEP = 0.2

#: A usual law of soft tissue below a probe, where nothing is known: 2 N/cm² at 10 mm
USUAL_LAW = DepthProfile((1.3,), (2.0,))


@dataclass(frozen=True)
class ModelPlan:
    """All but the surface and the probe that both sides must agree on.

    Attributes:
        shape: Voxels along r, θ, z [–].
        r_inner: Radius of the inner layer [m].
        law: φ of the prior.
        deviation: σ, relative standard deviation of stiffness about the law [–].
        memory: Time over which local stiffness fades [s].
    """

    shape: tuple[int, int, int] = (24, 72, 30)
    r_inner: float = 0.03
    law: DepthProfile = USUAL_LAW
    deviation: float = 0.4
    memory: float = 600.0


class LiveModel:
    """A depth map that learns from samples.

    Attributes:
        surface: The patient.
        shell: The probe.
        plan: How the model is made.
        learner: The depth map.
    """

    def __init__(
        self,
        surface: Surface,
        shell: PointShell,
        plan: ModelPlan,
        start: DepthMapState | None = None,
    ) -> None:
        """A model before the first sample.

        Args:
            surface: The patient.
            shell: The probe.
            plan: How it is made.
            start: What is known already; by default the plan's law alone.
        """
        voxmap = Voxmap.from_surface(surface, shape=plan.shape, r_inner=plan.r_inner)
        self.surface, self.shell, self.plan = surface, shell, plan
        self.learner = RecursiveDepthMap(
            voxmap,
            shell,
            plan.law,
            deviation=plan.deviation,
            memory=plan.memory,
            start=start,
        )
        self._last: Sample | None = None

    def fold(self, sample: Sample) -> Folded:
        """Learn from a sample; one that comes late counts as of the last one's time."""
        last, time = self._last, sample.time
        twist = None
        if last is not None:
            time = max(time, last.time)
            twist = _twist(last, sample)
        folded = self.learner.update(
            time, sample.rotation, sample.position, sample.wrench, twist=twist
        )
        if last is None or sample.time > last.time:
            self._last = sample
        return folded

    @property
    def field(self) -> PotentialField:
        """The present field."""
        return self.learner.field

    def over(self, surface: Surface) -> LiveModel:
        """The same knowledge over another surface, on the same grid."""
        grid = self.learner.lattice.voxmap.grid
        voxmap = Voxmap.from_surface(
            surface,
            shape=self.plan.shape,
            r_inner=self.plan.r_inner,
            r_outer=grid.r_outer,
        )
        moved = copy.copy(self)
        moved.surface, moved.learner = surface, self.learner.over(voxmap)
        return moved


def _twist(a: Sample, b: Sample) -> Array | None:
    """Velocity of the origin and angular velocity, (6,); None if unknown."""
    step = b.time - a.time
    if not 0.0 < step <= LONGEST_STEP:
        return None
    # sin φ times the axis, from the antisymmetric part
    between = b.rotation @ a.rotation.T
    odd = between - between.T
    turn = 0.5 * np.array([odd[2, 1], odd[0, 2], odd[1, 0]])
    return np.concatenate([b.position - a.position, turn]) / step

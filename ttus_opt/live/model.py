"""The model of a live session: a patient, a probe, and what was learned of them.

As a message it is the law, the friction and the relative stiffness at the lattice's
nodes, rounded to `STEP`, as differences along the body, compressed. The receiver has
the surface and the probe; a voxel's value is then a sum of eight numbers.
"""

from __future__ import annotations

import copy
import math
import struct
import zlib
from dataclasses import dataclass

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.recursion.depth_lattice import DEPTHS
from ttus_opt.fitting.recursion.recursive_depth_map import (
    DEVIATION,
    DepthMapState,
    Folded,
    RecursiveDepthMap,
)
from ttus_opt.live.messages import MessageError, Sample
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.problem.terms.depth_profile import DepthProfile
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap

#: Longest time between samples whose difference is a velocity [s]
LONGEST_STEP = 0.2

#: A usual law of soft tissue below a probe, where nothing is known: 5 N/cm² at 10 mm
#: below a contact 10 mm long, as three simulated torsos have 4.2 to 6.1
USUAL_LAW = DepthProfile((1.3,), (5.0,))


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
    deviation: float = DEVIATION
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


#: Largest rounding error of a relative stiffness is half of this [–]
STEP = 0.01

#: Largest values accepted: voxels and nodes, as much as case L; relative stiffness
MOST_VOXELS, MOST_NODES, MOST_STIFFNESS = 2_000_000, 20_000, 300.0

#: Largest exponent of a law accepted; tissue has 1 to 3 [–]
MOST_EXPONENT = 10.0

#: Plan: shape, inner radius, exponent and coefficient, σ, memory; state: scale, slope,
#: friction; shell: points, rms radius; nodes around, along
_HEAD = struct.Struct("<3H5f3fIf2H")


def encode_model(model: LiveModel) -> bytes:
    """A model as bytes, without its surface and probe."""
    plan, state, lattice = model.plan, model.learner.state, model.learner.lattice
    head = _HEAD.pack(
        *plan.shape,
        plan.r_inner,
        plan.law.exponents[0],
        plan.law.coefficients[0],
        plan.deviation,
        plan.memory,
        state.scale,
        state.slope,
        state.friction,
        len(model.shell.points),
        model.shell.rms_radius,
        lattice.n_theta,
        lattice.n_z,
    )
    values = np.clip(state.stiffness, -MOST_STIFFNESS, MOST_STIFFNESS)
    rounded = np.round(values / STEP).astype(np.int32)
    steps = np.diff(rounded, axis=0, prepend=0).astype("<i2")
    # high and low bytes apart compress better
    planes = np.frombuffer(steps.tobytes(), np.uint8).reshape(-1, 2).T
    return head + zlib.compress(planes.tobytes(), 9)


def decode_model(content: bytes, surface: Surface, shell: PointShell) -> LiveModel:
    """The model of a message over a surface and for a probe.

    Raises:
        MessageError: Damaged, out of range, or made for another probe or surface.
    """
    if len(content) < _HEAD.size:
        raise MessageError("a model's message ends early")
    numbers = _HEAD.unpack_from(content)
    shape, rest = numbers[:3], numbers[3:]
    r_inner, exponent, coefficient, deviation, memory, scale, slope, friction = rest[:8]
    points, radius, n_theta, n_z = rest[8:]
    if not all(math.isfinite(v) for v in rest):
        raise MessageError("a model's message contains NaN or infinity")
    if not (0.0 < exponent <= MOST_EXPONENT and coefficient > 0.0):
        raise MessageError(
            f"a law {coefficient:g} (d/10 mm)^{exponent:g} is not that of a tissue"
        )
    if points != len(shell.points) or abs(radius / shell.rms_radius - 1.0) > 1e-4:
        raise MessageError(
            f"the model is for a probe of {points} points and {1e3 * radius:.2f} mm, "
            f"this one has {len(shell.points)} and {1e3 * shell.rms_radius:.2f} mm: "
            "use the same probe and number of points on both sides"
        )
    count = n_theta * n_z * len(DEPTHS)
    if not 0 < math.prod(shape) <= MOST_VOXELS or not 0 < count <= MOST_NODES:
        raise MessageError(f"a model of {shape} voxels and {count} nodes is too large")
    expand = zlib.decompressobj()
    try:
        planes = expand.decompress(content[_HEAD.size :], 2 * count)
    except zlib.error as error:
        raise MessageError(f"a model's message is damaged: {error}") from error
    if len(planes) != 2 * count or not expand.eof:
        raise MessageError("a model's message has the wrong length")
    steps = np.frombuffer(planes, np.uint8).reshape(2, -1).T.tobytes()
    stiffness = np.frombuffer(steps, "<i2").reshape(n_theta, -1).cumsum(axis=0)
    law = DepthProfile((exponent,), (coefficient,))
    plan = ModelPlan((shape[0], shape[1], shape[2]), r_inner, law, deviation, memory)
    state = DepthMapState(
        law, scale, slope, STEP * stiffness.reshape(n_theta, n_z, len(DEPTHS)), friction
    )
    try:
        return LiveModel(surface, shell, plan, state)
    except InputError as error:
        raise MessageError(f"the model does not fit its surface: {error}") from error

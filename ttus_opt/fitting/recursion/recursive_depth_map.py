"""The depth map one measurement at a time: what a live session learns.

The field is p = φ(d) (1 + g), φ(d) = c (d/d₀)ᵃ, as `fit` chooses it by default, with g
on a lattice (`depth_lattice`). Scale and exponent of φ are unknown as well: with
q = ln(d/d₀) they enter linearly,

    p = φ(d) (1 + 3 s + 0.2 a q e + g),   s, e ~ Normal(0, 1), g ~ Normal(0, σ² K),

so that a wrench is linear in the state (s, e, g) and the Kalman filter is the exact
recursion of the batch fit. Only places that a measurement has touched are in the state;
g elsewhere is its prediction from them. Time and memory follow the area that was
touched and never the number of measurements.

Errors are those of `ttus_opt.problem.terms.part_noise`: of the normal force the
sensor's and one in proportion to the force, of its direction and torque 0.2 rad. A
measurement that disagrees by more than four standard deviations counts less, the less
the more it disagrees.

Friction μ ~ Normal(0, 0.1²) is in the state as well, by an extended Kalman filter: drag
is μ times that of all points at μ = 1 (`ttus_opt.contact.point_drag`), which is linear
in p. A press is heavier than its release; learned apart, that would be a stiffness that
changes with every stroke.

What was measured fades: g and μ follow Ornstein-Uhlenbeck processes, which return to
their prior over `memory`. The mean law does not fade.
"""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from ttus_opt.contact.friction import FRICTION
from ttus_opt.contact.rows import checked_poses, contact_rows
from ttus_opt.contact.slip import Slip
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.recursion.depth_lattice import DEPTHS, DepthLattice
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.problem.terms.depth_map import SCALE_DEVIATION, signed_depth
from ttus_opt.problem.terms.depth_map_estimate import PRIOR
from ttus_opt.problem.terms.depth_profile import REFERENCE_DEPTH, DepthProfile
from ttus_opt.problem.terms.part_noise import ALIKE, RELATIVE, SENSOR, TURN
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.sampling import sized
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap
from ttus_opt.voxmap.voxmap import Voxmap

#: σ and the length along the depth [m], as fits of three torsos estimate them
DEVIATION, DEPTH_LENGTH = 0.25, 0.015

#: Unknowns of the mean law, scale and exponent; where friction is in the state, and
#: from where on g of the places
LAW, MU, PLACES = 2, 2, 3

#: Standard deviation of μ before anything slid, and largest μ [–]; with a larger one
#: the first press into tissue of another stiffness is taken for friction
FRICTION_DEVIATION, MOST_FRICTION = 0.1, 1.0

#: Normalised residual from which a measurement counts less [–]
DISAGREES = 4.0

#: Speed below which the drag of a point fades [m/s]
LEAST_SPEED = 3e-3

#: Wrenches and twists at and beyond this are none [N, N·m, m/s, rad/s]
LARGEST = 1e9

#: Smallest share of the mean law that a field keeps [–]: p is never negative inside
LEAST_STIFFNESS = 0.02


def usual_sampling(shell: PointShell) -> str:
    """How contact samples a live depth map: by its size, ℓ₀ the probe's radius.

    Without the contact's size one law does not hold for light and deep presses, and
    new places err twice as much. Fits of torsos estimate ℓ₀ at 0.7 to 1.4 radii.
    """
    return sized(shell.rms_radius)


@dataclass(frozen=True)
class Folded:
    """What one measurement said.

    Attributes:
        contact_points: Shell points inside the patient; without any it says nothing.
        residual: Measured minus predicted force, shape (3,) [N].
        nis: Normalised innovation squared of force and torque [–].
        counts: Share with which it was taken, below 1 where it disagrees [–].
    """

    contact_points: int
    residual: Array = field(repr=False)
    nis: float
    counts: float


@dataclass(frozen=True)
class DepthMapState:
    """A depth map in numbers, all that another side needs to render it.

    Attributes:
        profile: φ, one power.
        scale: Mean of 1 + 3 s [–].
        slope: Mean of 0.2 a e [–].
        stiffness: Mean of g at the nodes, shape (n_theta, n_z, k) [–].
        friction: μ [–].
    """

    profile: DepthProfile
    scale: float
    slope: float
    stiffness: Array = field(repr=False)
    friction: float


class RecursiveDepthMap:
    """The most likely depth map of all measurements so far.

    Use an instance in one thread at a time.

    Attributes:
        lattice: Nodes of g.
        shell: The probe.
        profile: φ of the prior, one power.
        deviation: σ [–].
        memory: Time over which g returns to its prior [s].
        sampling: `usual_sampling`.
    """

    def __init__(
        self,
        voxmap: Voxmap,
        shell: PointShell,
        profile: DepthProfile,
        *,
        deviation: float = DEVIATION,
        surface_length: float | None = None,
        depth_length: float = DEPTH_LENGTH,
        memory: float = 600.0,
        start: DepthMapState | None = None,
    ) -> None:
        """Start from a prior.

        Args:
            voxmap: Patient.
            shell: Probe.
            profile: φ, one power: a guess, right within a factor of three.
            deviation: σ [–].
            surface_length: ℓ along the skin [m]; by default the prior's, in units of
                the probe.
            depth_length: Length along the depth [m].
            memory: Time over which g fades [s]; ``math.inf`` for never.
            start: An earlier map with the same profile, which is then the prior's mean.

        Raises:
            InputError: A value out of range, or a profile of several powers.
        """
        if len(profile.exponents) != 1:
            raise InputError("a live depth map starts from one power of depth")
        if not (deviation > 0.0 and memory > 0.0):
            raise InputError(
                f"deviation and memory must be positive, got {deviation}, {memory} s"
            )
        if surface_length is None:
            surface_length = PRIOR["surface_length"][0] * shell.rms_radius
        places = None if start is None else start.stiffness.shape[:2]
        self.shell, self.profile, self.deviation = shell, profile, deviation
        self.memory, self.sampling = memory, usual_sampling(shell)
        self._lay(DepthLattice.over(voxmap, surface_length, depth_length, places))
        self._law = np.array(
            [SCALE_DEVIATION, PRIOR["exponent"][1] * profile.exponents[0]]
        )
        self._places: IntArray = np.zeros(0, dtype=np.int64)  # touched, in the state
        self._mean, self._covariance = np.zeros(PLACES), np.eye(PLACES)
        self._base = np.zeros((self.lattice.n_places, len(DEPTHS)))
        self._time = -math.inf
        if start is not None:
            self._begin(start)

    def _lay(self, lattice: DepthLattice) -> None:
        """Take the nodes and voxels of a surface."""
        self.lattice = lattice
        self._depth = signed_depth(lattice.voxmap)
        self._phi = self.profile(self._depth)
        self._log_depth = np.log(np.abs(self._depth) / REFERENCE_DEPTH)
        vars(self).pop("_from_touched", None)

    def _begin(self, start: DepthMapState) -> None:
        """Take an earlier map as the prior's mean."""
        self._base = start.stiffness.reshape(self._base.shape).copy()
        self._mean[:LAW] = np.array([start.scale - 1.0, start.slope]) / self._law
        self._mean[MU] = start.friction / FRICTION_DEVIATION

    def over(self, voxmap: Voxmap) -> RecursiveDepthMap:
        """The same knowledge over another surface: its places move with the skin."""
        other, own = copy.copy(self), self.lattice
        places = own.n_theta, own.n_z
        other._lay(
            DepthLattice.over(voxmap, own.surface_length, own.depth_length, places)
        )
        return other

    def __repr__(self) -> str:
        return (
            f"<RecursiveDepthMap of {self.lattice.n_places} places, "
            f"{len(self._places)} touched>"
        )

    @property
    def touched(self) -> int:
        """Places in the state [–]."""
        return len(self._places)

    @property
    def friction(self) -> float:
        """μ; 0 until the probe has slid [–]."""
        return min(max(self._mu, 0.0), MOST_FRICTION)

    @property
    def _mu(self) -> float:
        """Mean of μ in the state, perhaps just below 0 where nothing rubs [–]."""
        return float(FRICTION_DEVIATION * self._mean[MU])

    @property
    def memory_bytes(self) -> int:
        """Memory that grows with the area touched."""
        return self._covariance.nbytes + self._mean.nbytes

    def update(
        self,
        time: float,
        rotation: Array,
        position: Array,
        wrench: Array,
        *,
        twist: Array | None = None,
    ) -> Folded:
        """Take one measurement.

        Args:
            time: Of the measurement, not before the last one [s].
            rotation: Probe to patient, shape (3, 3) [–].
            position: Origin of the probe frame, patient frame, shape (3,) [m].
            wrench: Force, then torque about the shell's reference, (6,) [N, N·m].
            twist: Velocity of that origin and angular velocity, patient axes, shape
                (6,) [m/s, rad/s]; at rest when not given.

        Raises:
            InputError: Values that are not finite, or not a pose; nothing is learnt.
        """
        wrench = _six(wrench, "a wrench", "N, N m")
        twist = None if twist is None else _six(twist, "a twist", "m/s, rad/s")
        R, at = checked_poses(np.asarray(rotation)[None], np.asarray(position)[None])
        pause = self._pass(time)
        patient = self.lattice.voxmap
        rows = contact_rows(patient, self.shell, R, at, sampling=self.sampling)
        points = int(rows.contact_points[0])
        if not points:
            return Folded(0, wrench[:3].copy(), 0.0, 1.0)
        long = self.shell.rms_radius
        parts = [rows.N, rows.W / long, *self._drag_rows(R, at, twist)]
        H, prior = self._state_rows(sp.csr_array(sp.vstack(parts)))
        both = prior + H @ self._mean
        prior, expected = prior[:6], both[:6]
        rubs = both[6:] if twist is not None else np.zeros(6)  # drag at μ = 1
        measured = wrench.copy()
        measured[3:] /= self.shell.rms_radius
        size = float(np.linalg.norm(prior[:3]))
        normal = prior[:3] / size if size > 0.0 else np.zeros(3)
        pressed = max(float(normal @ expected[:3]), 0.0)
        if twist is not None:
            H = H[:6] + self._mu * H[6:]
            H[:, MU] = FRICTION_DEVIATION * rubs
        residual = measured - expected - self._mu * rubs
        noise = _noise(normal, pressed, ALIKE / max(min(pause, ALIKE), 1e-3))
        cross = self._covariance @ H.T
        spread = H @ cross + noise
        nis = float(residual @ np.linalg.solve(spread, residual))
        counts = min(1.0, (DISAGREES**2 / max(nis / len(H), 1e-12)) ** 2)
        spread += (1.0 / counts - 1.0) * noise
        gain = scipy.linalg.solve(spread, cross.T, assume_a="pos")
        self._mean = self._mean + residual @ gain
        self._covariance = self._covariance - cross @ gain
        return Folded(points, residual[:3], nis, counts)

    @property
    def state(self) -> DepthMapState:
        """The present mean, at every node."""
        s, e = self._law * self._mean[:LAW]
        rest = self._mean[PLACES:].reshape(-1, len(DEPTHS))
        everywhere = self._base + self._from_touched @ rest
        stiffness = everywhere.reshape(self.lattice.n_theta, self.lattice.n_z, -1)
        return DepthMapState(self.profile, 1.0 + s, e, stiffness, self.friction)

    @property
    def field(self) -> PotentialField:
        """The present mean as a field."""
        return self.field_of(self.state)

    def field_of(self, state: DepthMapState) -> PotentialField:
        """A field of this patient from the numbers of a depth map."""
        voxmap = self.lattice.voxmap
        share = self.lattice.weights @ state.stiffness.ravel()
        share += state.scale + state.slope * self._log_depth
        values = state.profile(self._depth)
        values *= np.maximum(share, LEAST_STIFFNESS)
        parameters = {"law_scale": state.scale, "law_slope": state.slope}
        if state.friction > 0.0:
            parameters[FRICTION] = state.friction
        return PotentialField(
            voxmap,
            voxmap.grid.unflatten(values),
            self.sampling,
            parameters,
            {"formulation": "depth_map", "solver": "recursive depth map"},
        )

    @property
    def uncertainty(self) -> UncertaintyMap:
        """Relative standard deviation at the reference depth, at most 3."""
        lattice = self.lattice
        k = int(np.argmin(np.abs(lattice.depths - REFERENCE_DEPTH)))
        B, prior = self._from_touched, lattice.over_skin
        rest = np.zeros(len(prior))
        if len(self._places):
            rest = np.einsum("ij,ij->i", B, prior[:, self._places])
        unknown = self.deviation**2 * np.maximum(1.0 - rest, 0.0)
        at = PLACES + len(DEPTHS) * np.arange(len(self._places)) + k
        chosen = np.concatenate([[0], at])  # the scale, and g at that depth
        H = np.hstack([np.full((len(prior), 1), self._law[0]), B])
        spread = self._covariance[np.ix_(chosen, chosen)]
        variance = unknown + np.einsum("ij,jk,ik->i", H, spread, H)
        mean = np.maximum(1.0 + H @ self._mean[chosen], LEAST_STIFFNESS)
        relative = np.minimum(np.sqrt(variance) / mean, SCALE_DEVIATION)
        relative = relative.reshape(lattice.n_theta, lattice.n_z)
        return UncertaintyMap(lattice.theta, lattice.z, relative)

    def _pass(self, time: float) -> float:
        """Let time pass since the last measurement; how much [s]."""
        if not math.isfinite(time) or time < self._time:
            raise InputError(f"time must not go back [s], got {time}")
        pause = time - self._time
        self._time = time
        if not (math.isfinite(pause) and math.isfinite(self.memory)):
            return pause
        stays = math.exp(-pause / self.memory)
        if stays < 1.0:
            factor = np.ones(len(self._mean))
            factor[LAW:] = stays
            self._mean = self._mean * factor
            self._covariance = self._covariance * (factor[:, None] * factor)
            fresh = 1.0 - stays**2
            self._covariance[MU, MU] += fresh
            self._covariance[PLACES:, PLACES:] += fresh * self._prior(self._places)
        return pause

    def _prior(self, places: IntArray) -> Array:
        """Prior covariance of g at the nodes of some places."""
        skin = self.lattice.over_skin[np.ix_(places, places)]
        return np.asarray(self.deviation**2 * np.kron(skin, self.lattice.over_depth))

    def _state_rows(self, rows: sp.csr_array) -> tuple[Array, Array]:
        """Rows by the state, (6, n), after adding the places they touch.

        The second result is their value for a state of zero, shape (6,).
        """
        weighted = sp.csr_array(rows @ sp.diags_array(self._phi))
        prior = np.asarray(weighted @ np.ones(weighted.shape[1]))
        by_node = sp.csr_array(weighted @ self.lattice.weights)
        nodes = np.unique(by_node.indices[by_node.data != 0.0])
        self._add(np.setdiff1d(nodes // len(DEPTHS), self._places))
        H = np.empty((len(prior), len(self._mean)))
        H[:, 0] = self._law[0] * prior
        H[:, 1] = self._law[1] * (weighted @ self._log_depth)
        columns = self._places[:, None] * len(DEPTHS) + np.arange(len(DEPTHS))
        H[:, MU] = 0.0
        H[:, PLACES:] = by_node[:, columns.ravel()].toarray()
        return H, prior + by_node @ self._base.ravel()

    def _add(self, places: IntArray) -> None:
        """Add places by what those in the state predict of them."""
        if not len(places):
            return
        B = self._predictor(places)
        skin = self.lattice.over_skin
        left = skin[np.ix_(places, places)] - B @ skin[np.ix_(self._places, places)]
        fresh = self.deviation**2 * np.kron(left, self.lattice.over_depth)
        full = np.zeros((len(fresh), len(self._mean)))
        full[:, PLACES:] = np.kron(B, np.eye(len(DEPTHS)))
        cross = full @ self._covariance
        own = cross @ full.T + fresh
        self._mean = np.concatenate([self._mean, full @ self._mean])
        self._covariance = np.block([[self._covariance, cross.T], [cross, own]])
        self._places = np.concatenate([self._places, places])
        vars(self).pop("_from_touched", None)

    def _predictor(self, places: IntArray) -> Array:
        """G at some places from g at those in the state, shape (n, touched)."""
        held, skin = self._places, self.lattice.over_skin
        if not len(held):
            return np.zeros((len(places), 0))
        among = skin[np.ix_(held, held)] + 1e-9 * np.eye(len(held))
        solved = scipy.linalg.solve(among, skin[np.ix_(held, places)], assume_a="pos")
        return np.asarray(solved.T)

    @cached_property
    def _from_touched(self) -> Array:
        """G at all places from g at those in the state, computed once per set."""
        return self._predictor(np.arange(self.lattice.n_places))

    def _drag_rows(
        self, R: Array, at: Array, twist: Array | None
    ) -> list[sp.csr_array]:
        """Rows of drag at μ = 1, of every point for itself: force, and torque over ℓ.

        A probe that is pressed straight in slides along its flanks: its force is larger
        than that of its release, which without friction looks like two stiffnesses.
        """
        if twist is None:
            return []
        rows = contact_rows(
            self.lattice.voxmap,
            self.shell,
            R,
            at,
            sampling=self.sampling,
            slip=Slip.of(self.shell, R, twist[None], LEAST_SPEED),
        )
        return [-rows.N, sp.csr_array(rows.W / -self.shell.rms_radius)]


def _six(values: Array, name: str, units: str) -> Array:
    """Six numbers; `InputError` where they are none, or beyond any hand's."""
    six = np.asarray(values, dtype=np.float64)
    if six.shape != (6,) or not (np.abs(six) < LARGEST).all():
        raise InputError(f"{name} must be 6 finite numbers [{units}], got {values}")
    return six


def _noise(normal: Array, pressed: float, crowded: float) -> Array:
    """Covariance of the errors of force and torque over ℓ, shape (6, 6) [N²]."""
    own = SENSOR**2 + (RELATIVE * pressed) ** 2
    across = own + (TURN * pressed) ** 2
    noise = across * np.eye(6)
    noise[:3, :3] += (own - across) * np.outer(normal, normal)
    return crowded * noise

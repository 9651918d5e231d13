"""Hand-eye calibration from two streams of poses with clocks of their own.

A tracker or camera sees a marker over time, A(t), and a robot or a second tracker gives
the hand that carries it, B(s). As in `ttus_opt.sensors.hand_eye`,

    G X A = Z,   G = B (camera on the hand)   or   G = B⁻¹ (fixed camera).

The clocks are aligned by the angular speeds, which are the same in every frame, then by
the angles between instants, which noise and gaps spoil less. Frames whose turns
contradict the other stream's are left out, and pairs are spread over the rotations.
OpenCV's solvers on small random sets give a start that outliers do not spoil; X, Z and
the offset of the clocks are then fitted together, with Huber's loss.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np
from scipy.optimize import OptimizeResult, least_squares
from scipy.spatial.transform import Rotation

from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.probe.rigid_motion import (
    homogeneous,
    inverse,
    left_jacobian,
    motion_of,
    six_of,
)
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors import hand_eye
from ttus_opt.sensors.angular_offset import angular_offset
from ttus_opt.sensors.clock import LARGEST_OFFSET, Offset
from ttus_opt.sensors.stream_pairs import (
    agreeing,
    aligned,
    far_apart,
    offset_by_angles,
    without_spikes,
)
from ttus_opt.sensors.streams import placed

#: Most pairs, and fewest
MOST_PAIRS, LEAST_PAIRS = 200, 20

#: Random sets of pairs for the start, and pairs in each
STARTS, START_PAIRS = 24, 8

#: Stretches of a recording whose fits are compared
STRETCHES = 6

#: Residuals beyond so many robust standard deviations are outliers
OUTLIER = 4.0

#: Rounds of fit and scale
ROUNDS = 3

#: Least scales of residuals, so that exact poses are no division by zero [rad, m]
LEAST_SCALE = np.array([1e-8] * 3 + [1e-9] * 3)

#: A larger standard error of the position is no calibration [m]
LARGEST_STD = 0.02

#: Loops that close so much better with inverted poses say that they are inverted
CLOSER = 1.0 / 3.0

#: From the median absolute value of Normal errors to their standard deviation
MEDIAN = 1.4826


@dataclass(frozen=True)
class StreamHandEye:
    """A camera's pose and the offset of the clocks.

    Attributes:
        camera: Camera to base, or to hand where it moves, shape (4, 4) [–, m].
        marker: Marker to hand, or to base where the camera moves, shape (4, 4).
        covariance: Of the camera's turn and shift in its target frame, (6, 6)
            [rad², rad m, m²].
        offset: Seconds to add to the hand's clock [s].
        offset_std: Its standard error [s].
        correlation: Of the angular speeds.
        loop: How well the loops of the pairs used close.
        median_gap: Median distance of all pairs, outliers too [m].
        median_twist: Median angle of all pairs, outliers too [rad].
        pairs: Number of pairs used.
        outliers: Frames and pairs left out.
    """

    camera: Array
    marker: Array = field(repr=False)
    covariance: Array = field(repr=False)
    offset: float
    offset_std: float
    correlation: float
    loop: hand_eye.Loop
    median_gap: float
    median_twist: float
    pairs: int
    outliers: int

    @property
    def turn_std(self) -> float:
        """Standard error of the camera's rotation, about any axis [rad]."""
        return float(np.sqrt(np.trace(self.covariance[:3, :3]) / 3.0))

    @property
    def shift_std(self) -> Array:
        """Standard errors of the camera's position, shape (3,) [m]."""
        return np.sqrt(np.diag(self.covariance)[3:])


def stream_hand_eye(
    seen: Trajectory,
    carried: Trajectory,
    camera: hand_eye.Camera,
    *,
    inverted: bool = False,
    offset: float | None = None,
    around: float = 0.0,
    largest: float = LARGEST_OFFSET,
    rng: np.random.Generator | None = None,
) -> StreamHandEye:
    """The camera's pose from a marker's poses in it and a hand's poses in its base.

    Args:
        seen: A: marker to camera, on the camera's clock.
        carried: B: hand to base, on its own clock.
        camera: ``fixed``: the hand holds the marker. ``moving``: the hand holds the
            camera and the marker is fixed.
        inverted: A holds the camera's poses in the marker's frame instead.
        offset: Seconds to add to the hand's clock, where it is known.
        around: As in `ttus_opt.sensors.clock.clock_offset`.
        largest: As in `ttus_opt.sensors.clock.clock_offset`.
        rng: Chooses the random sets.

    Raises:
        InputError: The streams do not show one motion, do not overlap, or close their
            loops with inverted poses only.
        GeometryError: The motion does not determine the camera's pose.
    """
    expect_one_of(camera, get_args(hand_eye.Camera), "camera")
    rng = np.random.default_rng(0) if rng is None else rng
    n_seen = len(seen)
    seen, carried = without_spikes(seen), without_spikes(carried)
    if offset is not None:
        clock = Offset(offset, correlation=np.nan, rival=np.nan, std=0.0)
    else:
        clock = angular_offset(seen, carried, around=around, largest=largest)
        clock = clock._replace(seconds=offset_by_angles(seen, carried, clock.seconds))
    A, path, left_out = _paired(seen, carried, clock.seconds, rng)
    left_out += n_seen - len(seen)

    def answer(A: Array) -> StreamHandEye:
        problem = _Problem(A, path, camera == "fixed")
        fit = _fitted(problem, _start(problem, rng), free_offset=offset is None)
        hand_eye.check_motions(A[fit.used], path.poses(0.0)[fit.used])
        return _answer(problem, fit, clock, left_out)

    given, other = (inverse(A), A) if inverted else (A, inverse(A))
    found = answer(given)
    certain = bool(found.shift_std.max() < LARGEST_STD)
    if not certain or found.median_gap > hand_eye.LARGEST_GAP:
        try:
            gap = answer(other).median_gap
        except InputError:  # no better
            gap = np.inf
        if gap < CLOSER * found.median_gap:
            raise InputError(_inverted(found.median_gap, gap, camera, inverted))
    if not certain:
        raise GeometryError(
            "the motion hardly tells where the camera is: its position has a standard "
            f"error of {1e3 * found.shift_std.max():.3g} mm with loops that close to "
            f"{1e3 * found.median_gap:.2g} mm: turn the hand about two or more axes, "
            "by 30° and more; poses that drift, as odometry's do, tell less"
        )
    return found


def _inverted(
    gap: float, other_gap: float, camera: hand_eye.Camera, inverted: bool
) -> str:
    """What is wrong where loops close with inverted poses only [m]."""
    other = "moving" if camera == "fixed" else "fixed"
    remedy = (
        "marker's in the camera, leave inverted=True out"
        if inverted
        else "camera's in the marker's frame, give inverted=True"
    )
    return (
        f"the loops close to {1e3 * gap:.3g} mm, but to {1e3 * other_gap:.2g} mm with "
        f"camera={other}, and so with the first stream's poses inverted: if they are "
        f"the {remedy}"
    )


def _paired(
    seen: Trajectory, carried: Trajectory, offset: float, rng: np.random.Generator
) -> tuple[Array, _Path, int]:
    """A (n, 4, 4) and B of pairs spread over rotations, and frames that disagree."""
    time, A, B = aligned(seen, carried, offset)
    agree = agreeing(A, B, rng)
    pairs = np.flatnonzero(agree)
    if len(pairs) < LEAST_PAIRS:
        raise InputError(
            f"only {len(pairs)} of {len(time)} common frames turn alike in both "
            "streams: are they of one body, and is the offset right?"
        )
    pairs = pairs[far_apart(A[pairs, :3, :3], MOST_PAIRS)]
    if len(pairs) < LEAST_PAIRS:
        raise GeometryError(
            f"the marker takes only {len(pairs)} orientations: turn the hand about two "
            "or more axes"
        )
    hand_eye.check_motions(A[pairs], B[pairs])
    return A[pairs], _Path(carried, time[pairs] - offset), int((~agree).sum())


class _Path:
    """The hand's poses at any offset of its clock.

    Attributes:
        at: Times on the hand's clock, shape (n,) [s].
    """

    def __init__(self, carried: Trajectory, at: Array) -> None:
        self.at = at
        step = np.median(np.diff(carried.time)[np.diff(carried.segment) == 0])
        path = carried.select(np.unique(carried.time, return_index=True)[1])
        before, self._now, after = (
            homogeneous(*placed(path, np.clip(at + d, path.time[0], path.time[-1])))
            for d in (-step, 0.0, step)
        )
        turn = Rotation.from_matrix(after[:, :3, :3] @ before[:, :3, :3].swapaxes(1, 2))
        self._turning = turn.as_rotvec() / (2.0 * step)
        self._moving = (after[:, :3, 3] - before[:, :3, 3]) / (2.0 * step)

    def poses(self, later: float) -> Array:
        """Poses at a small shift of the clock [s], shape (n, 4, 4)."""
        turn = Rotation.from_rotvec(later * self._turning).as_matrix()
        place = self._now[:, :3, 3] + later * self._moving
        return homogeneous(turn @ self._now[:, :3, :3], place)


@dataclass(frozen=True)
class _Problem:
    """Pairs of poses.

    Attributes:
        A: Marker to camera, shape (n, 4, 4).
        path: Hand to base.
        fixed: Whether the camera stands still.
    """

    A: Array
    path: _Path
    fixed: bool

    def G(self, later: float = 0.0) -> Array:
        """G of every pair, shape (n, 4, 4)."""
        B = self.path.poses(later)
        return inverse(B) if self.fixed else B

    def residuals(self, parameters: Array) -> Array:
        """Turn [rad] and shift [m] of Z⁻¹ G X A, shape (n, 6).

        Args:
            parameters: X and Z as rotation vector [rad] and shift [m] each, and the
                shift of the clock [s], shape (13,).
        """
        X, Z = motion_of(parameters[:6]), motion_of(parameters[6:12])
        off = inverse(Z) @ self.G(parameters[12]) @ X @ self.A
        return six_of(off)


def _start(problem: _Problem, rng: np.random.Generator) -> Array:
    """X and Z (12,) whose median loop is best among random sets of pairs."""
    G, best, least = problem.G(), None, np.inf
    for _ in range(STARTS):
        own = rng.choice(len(G), START_PAIRS, replace=False)
        for found in hand_eye.solved(G[own], problem.A[own]).values():
            ends = (G @ found.camera @ problem.A)[:, :3, 3]
            gap = float(np.median(np.linalg.norm(ends - found.marker[:3, 3], axis=1)))
            if gap < least:
                best, least = np.r_[six_of(found.camera), six_of(found.marker)], gap
    if best is None:
        raise InputError("no solver has an answer: are the streams of one body?")
    return np.asarray(best)


@dataclass(frozen=True)
class _Fit:
    """A fit.

    Attributes:
        parameters: Shape (13,).
        residuals: Shape (n, 6) [rad, m].
        covariance: Shape (13, 13).
        used: Pairs that are no outliers, shape (n,).
    """

    parameters: Array
    residuals: Array
    covariance: Array
    used: Mask


def _fitted(problem: _Problem, start: Array, *, free_offset: bool) -> _Fit:
    """X, Z and the clock by robust least squares, outliers left out at the end."""
    free = np.ones(13, bool)
    free[12] = free_offset
    parameters = np.r_[start, 0.0]
    used = np.ones(len(problem.A), bool)
    scale = _scale(problem.residuals(parameters))

    def solve(
        parameters: Array, rows: Mask, loss: Literal["linear", "huber"]
    ) -> OptimizeResult:
        def weighted(some: Array) -> Array:
            full = parameters.copy()
            full[free] = some
            return (problem.residuals(full)[rows] / scale).ravel()

        return least_squares(
            weighted, parameters[free], x_scale="jac", loss=loss, f_scale=1.5
        )

    for _ in range(ROUNDS):
        parameters[free] = solve(parameters, used, "huber").x
        scale = _scale(problem.residuals(parameters))
    off = np.abs(problem.residuals(parameters)) / scale
    used = np.asarray(off.max(axis=1) <= OUTLIER)
    last = solve(parameters, used, "linear")
    parameters[free] = last.x
    residuals = problem.residuals(parameters)
    spread = residuals[used].std(axis=0) / scale
    information = last.jac.T @ (last.jac / np.tile(spread**2, used.sum())[:, None])
    covariance = np.zeros((13, 13))
    model = np.linalg.pinv(information)
    off = last.fun.reshape(-1, 6)
    covariance[np.ix_(free, free)] = model * _dependence(
        last.jac, off, model, problem.path.at[used]
    )
    return _Fit(parameters, residuals, covariance, used)


def _scale(residuals: Array) -> Array:
    """Robust standard deviations, one for the turns and one for the shifts, (6,)."""
    out = np.empty(6)
    for part in (slice(0, 3), slice(3, 6)):
        out[part] = MEDIAN * np.median(np.abs(residuals[:, part]))
    return np.asarray(np.maximum(out, LEAST_SCALE))


def _dependence(J: Array, residuals: Array, model: Array, time: Array) -> float:
    """Factor on the variance because errors resemble each other, ≥ 1.

    A camera's and an arm's errors depend on where they are, so that a fit is wrong by
    more than independent errors say. Deleted in turn, long stretches of the recording
    tell how much: the jackknife's variance over the model's, mean over parameters.

    Args:
        J: Derivatives of the scaled residuals, shape (6 n, k).
        residuals: Scaled, shape (n, 6).
        model: Covariance if errors were independent, shape (k, k).
        time: Of the pairs, shape (n,) [s].
    """
    stretches = np.array_split(np.argsort(time), STRETCHES)
    rows, off = J.reshape(len(time), 6, -1), residuals
    total, squares = J.T @ J, 0.0
    for own in stretches:
        part = rows[own].reshape(-1, J.shape[1])
        change = np.linalg.lstsq(total - part.T @ part, part.T @ off[own].ravel())[0]
        squares += float(change @ np.linalg.lstsq(model, change)[0])
    variance = (STRETCHES - 1) / STRETCHES * squares
    return max(1.0, variance / len(model))


def _answer(
    problem: _Problem, fit: _Fit, clock: Offset, disagreeing: int
) -> StreamHandEye:
    X, Z = motion_of(fit.parameters[:6]), motion_of(fit.parameters[6:12])
    J = left_jacobian(fit.parameters)
    gap = np.linalg.norm(fit.residuals[:, 3:], axis=1)
    twist = np.linalg.norm(fit.residuals[:, :3], axis=1)
    used = fit.used
    loop = hand_eye.Loop(
        float(gap[used].mean()), float(twist[used].mean()), float(gap[used].max())
    )
    std = float(np.sqrt(fit.covariance[12, 12]))
    return StreamHandEye(
        X,
        Z,
        J @ fit.covariance[:6, :6] @ J.T,
        clock.seconds - float(fit.parameters[12]),
        std if std > 0.0 else clock.std,
        clock.correlation,
        loop,
        float(np.median(gap)),
        float(np.median(twist)),
        int(used.sum()),
        disagreeing + int((~used).sum()),
    )

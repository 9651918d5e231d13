"""Hand-eye calibration: where a camera is, from pairs of poses (docs/method, 18.2).

Every pair holds a marker's pose in the camera, A, and the hand's pose in the base, B.
The camera is on the hand and the marker fixed, or the camera is fixed and the marker on
the hand. Either way every pair closes a loop,

    G X A = Z,   G = B (camera on the hand)   or   G = B⁻¹ (fixed camera),

with X from the camera to the hand or base, and Z from the marker to the base or hand.
OpenCV's five hand-eye and two robot-world solvers are compared. OpenCV does not notice
motions that do not determine X, nor inverted poses: both are tested here.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, GeometryError, InputError, located, warn
from ttus_opt.probe.rigid_motion import (
    homogeneous,
    inverse,
    read_numbers,
    rigid_motion,
)

Camera = Literal["fixed", "moving"]

HAND_EYE = ("TSAI", "PARK", "HORAUD", "ANDREFF", "DANIILIDIS")
ROBOT_WORLD = ("SHAH", "LI")
SOLVERS = tuple(name.lower() for name in (*HAND_EYE, *ROBOT_WORLD))

#: Fewest pairs: two motions
LEAST_PAIRS = 3

#: Least root-mean-square rotation about a second axis [rad]
LEAST_TURN = np.deg2rad(5.0)

#: Largest median difference between the rotation angles of marker and hand [rad]
LARGEST_MISMATCH = np.deg2rad(2.0)

#: Largest mean loop error that is accepted [m, rad]
LARGEST_GAP, LARGEST_TWIST = 0.010, np.deg2rad(1.0)

#: A larger difference between solvers gives a warning [m]
LARGEST_SPREAD = 0.002

#: Larger entries of a pose are refused, in any unit
LARGEST_NUMBER = 1e6

#: Largest file [byte]
LARGEST_FILE = 10_000_000


class Loop(NamedTuple):
    """How well the loops of all pairs close.

    Attributes:
        gap: Mean distance from the mean Z [m].
        twist: Mean angle from it [rad].
        worst: Largest distance [m].
    """

    gap: float
    twist: float
    worst: float

    def facts(self) -> dict[str, float]:
        """By name, with units, for JSON."""
        degrees = float(np.rad2deg(self.twist))
        return {
            "loop_m": self.gap,
            "loop_worst_m": self.worst,
            "loop_degrees": degrees,
        }

    def __str__(self) -> str:
        return f"close to {1e3 * self.gap:.2f} mm and {np.rad2deg(self.twist):.3f}°"


class Candidate(NamedTuple):
    """What one solver found.

    Attributes:
        camera: X, shape (4, 4).
        marker: Z, the mean over the pairs, shape (4, 4).
        loop: How well the loops close.
    """

    camera: Array
    marker: Array
    loop: Loop


@dataclass(frozen=True)
class HandEye:
    """A camera's pose, from the solver whose loops close best.

    Attributes:
        camera: Camera to base, or to hand where it moves, shape (4, 4) [–, m].
        marker: Marker to hand, or to base where the camera moves, shape (4, 4).
        loop: How well the loops close.
        solver: Its name.
        candidates: All answers, by solver; without those of solvers that failed.
        pairs: Number of pairs.
    """

    camera: Array
    marker: Array = field(repr=False)
    loop: Loop
    solver: str
    candidates: dict[str, Candidate] = field(repr=False)
    pairs: int

    @property
    def spread(self) -> float:
        """Largest distance between cameras of solvers whose loops close [m]."""
        places = [
            found.camera[:3, 3]
            for found in self.candidates.values()
            if _closes(found.loop)
        ]
        return max(
            (float(np.linalg.norm(a - b)) for a in places for b in places), default=0.0
        )


def read_pose_pairs(path: str | os.PathLike[str]) -> tuple[Array, Array]:
    """Pairs of poses: marker to camera and hand to base, shape (n, 4, 4) each [–, m].

    Args:
        path: JSON or NPY of shape (n, 2, 4, 4).

    Raises:
        FileError: Missing, damaged, or of another shape.
    """
    how = "JSON or NPY of shape (n, 2, 4, 4)"
    pairs = read_numbers(path, "pairs of poses", how, LARGEST_FILE)
    if pairs.ndim != 4 or pairs.shape[1:] != (2, 4, 4):
        raise FileError(
            f"{path} has shape {pairs.shape}, expected (n, 2, 4, 4): marker in camera, "
            "then hand in base, as matrices"
        )
    return pairs[:, 0], pairs[:, 1]


def hand_eye(
    marker_in_camera: Sequence[Array] | Array,
    hand_in_base: Sequence[Array] | Array,
    camera: Camera,
    *,
    largest_gap: float = LARGEST_GAP,
    largest_twist: float = LARGEST_TWIST,
) -> HandEye:
    """The camera's pose from pairs of poses.

    Args:
        marker_in_camera: A: marker to camera, shape (n, 4, 4) [–, m].
        hand_in_base: B: hand to base, shape (n, 4, 4) [–, m].
        camera: ``fixed``: the hand holds the marker. ``moving``: the hand holds the
            camera and the marker is fixed.
        largest_gap: Largest mean distance of a loop [m].
        largest_twist: Largest mean angle of a loop [rad].

    Returns:
        The answer of the solver whose loops close best, and all others.

    Raises:
        InputError: Too few pairs, invalid poses, pairs that do not belong together, or
            loops that do not close; the message says whether inverted poses would.
        GeometryError: The motions turn about one axis only.
    """
    expect_one_of(camera, get_args(Camera), "camera")
    if not (largest_gap > 0.0 and largest_twist > 0.0):
        raise InputError(
            f"the largest gap and twist must be above 0, got {largest_gap:g} m and "
            f"{np.rad2deg(largest_twist):g}°"
        )
    A = _checked("marker_in_camera", marker_in_camera)
    B = _checked("hand_in_base", hand_in_base)
    if len(A) != len(B) or len(A) < LEAST_PAIRS:
        raise InputError(
            f"hand-eye calibration takes at least {LEAST_PAIRS} pairs of poses, got "
            f"{len(A)} and {len(B)}"
        )
    check_motions(A, B)
    candidates = solved(inverse(B) if camera == "fixed" else B, A)
    best = _best(candidates)
    limits = largest_gap, largest_twist
    if best is None or not _closes(candidates[best].loop, *limits):
        loop = None if best is None else candidates[best].loop
        found = (
            "no solver has an answer"
            if loop is None
            else f"{1e3 * loop.gap:.3g} mm and {np.rad2deg(loop.twist):.2g}° on average"
        )
        raise InputError(
            f"the loops do not close: {found}, expected at most "
            f"{1e3 * largest_gap:g} mm and {np.rad2deg(largest_twist):g}°: "
            f"{_remedy(A, B, camera)}"
        )
    answer = HandEye(*candidates[best], best, candidates, len(A))
    if answer.spread > LARGEST_SPREAD:
        warn(
            f"the solvers' results differ by {1e3 * answer.spread:.2g} mm: record "
            "larger turns about more axes"
        )
    return answer


def _checked(name: str, poses: Sequence[Array] | Array) -> Array:
    """Poses (n, 4, 4), each validated as a rigid motion."""
    given = np.asarray(poses, dtype=np.float64)
    if given.ndim != 3 or given.shape[1:] != (4, 4):
        raise InputError(f"{name} must be (n, 4, 4), got {given.shape}")
    if not np.abs(given).max(initial=0.0) < LARGEST_NUMBER:
        raise InputError(f"{name} contains NaN or numbers that no pose has [m]")
    out = np.empty_like(given)
    for i, pose in enumerate(given):
        with located(f"{name}, pose {i + 1}"):
            out[i] = rigid_motion(pose)
    return out


def _turns(poses: Array) -> Array:
    """Rotation vectors between all pairs of poses, shape (k, 3) [rad]."""
    of = Rotation.from_matrix(poses[:, :3, :3])
    first, second = np.triu_indices(min(len(poses), 200), 1)
    return np.asarray((of[second] * of[first].inv()).as_rotvec())


def check_motions(A: Array, B: Array) -> None:
    """Validate, before any solver runs, that the motions determine the camera.

    Raises:
        GeometryError: They turn too little, or about one axis only.
        InputError: Marker and hand turn by different angles.
    """
    of_marker, of_hand = _turns(A), _turns(B)
    for name, turns in (("marker", of_marker), ("hand", of_hand)):
        squares = np.linalg.eigvalsh(turns.T @ turns / len(turns))[::-1]
        spread = np.sqrt(np.maximum(squares, 0.0))
        if spread[1] < LEAST_TURN:
            first, second, least = np.rad2deg([*spread[:2], LEAST_TURN])
            raise GeometryError(
                f"the {name} turns by {first:.2g}° about one axis and {second:.2g}° "
                f"about others, at least {least:g}° are needed: record poses tilted "
                "about two axes"
            )
    angles = [np.linalg.norm(turns, axis=1) for turns in (of_marker, of_hand)]
    apart = float(np.median(np.abs(angles[0] - angles[1])))
    if apart > LARGEST_MISMATCH:
        raise InputError(
            f"marker and hand turn by angles that differ by {np.rad2deg(apart):.3g}° "
            "in the median: are the pairs of the same instants, in the same order?"
        )


def solved(G: Array, A: Array) -> dict[str, Candidate]:
    """The answers to G X A = Z of those solvers that have one."""
    import cv2

    def by_motions(name: str) -> Array:
        method = getattr(cv2, f"CALIB_HAND_EYE_{name}")
        return _motion(*cv2.calibrateHandEye(*_parts(G), *_parts(A), method=method))

    def by_both(name: str) -> Array:
        method = getattr(cv2, f"CALIB_ROBOT_WORLD_HAND_EYE_{name}")
        # A Z⁻¹ = X⁻¹ G⁻¹: the last two returned are X⁻¹
        of_both = cv2.calibrateRobotWorldHandEye(
            *_parts(A), *_parts(inverse(G)), method=method
        )
        return inverse(_motion(*of_both[2:]))

    found = {}
    for solver in SOLVERS:
        name = solver.upper()
        try:
            X = by_motions(name) if name in HAND_EYE else by_both(name)
        except (cv2.error, InputError, np.linalg.LinAlgError):
            continue  # it fails, or returns no rigid motion
        found[solver] = _candidate(G, X, A)
    return found


def _parts(poses: Array) -> tuple[list[Array], list[Array]]:
    """Rotations (3, 3) and positions (3,) of n poses."""
    return [*poses[:, :3, :3]], [*poses[:, :3, 3]]


def _motion(R: Any, t: Any) -> Array:
    return rigid_motion(homogeneous(R, t.reshape(3)))


def _candidate(G: Array, X: Array, A: Array) -> Candidate:
    """An answer and its loops."""
    Z = G @ X @ A
    turns, places = Rotation.from_matrix(Z[:, :3, :3]), Z[:, :3, 3]
    middle = turns.mean()
    gaps = np.linalg.norm(places - places.mean(axis=0), axis=1)
    twists = (turns * middle.inv()).magnitude()
    loop = Loop(float(gaps.mean()), float(twists.mean()), float(gaps.max()))
    return Candidate(X, homogeneous(middle.as_matrix(), places.mean(axis=0)), loop)


def _closes(loop: Loop, gap: float = LARGEST_GAP, twist: float = LARGEST_TWIST) -> bool:
    return loop.gap <= gap and loop.twist <= twist


def _best(candidates: dict[str, Candidate]) -> str | None:
    """The solver whose loops close best; None where none has an answer."""
    return min(candidates, key=lambda name: candidates[name].loop.gap, default=None)


def _remedy(A: Array, B: Array, camera: Camera) -> str:
    """Advice for loops that do not close: the other ``camera``, where it fits."""
    kinds = {"fixed": "a fixed camera", "moving": "the camera on the hand"}
    expected = (
        f"expected are marker-to-camera and hand-to-base with {kinds[camera]}, check "
        "that no pose is inverted"
    )
    other = "moving" if camera == "fixed" else "fixed"
    tried = solved(inverse(B) if other == "fixed" else B, A)
    solver = _best(tried)
    if solver is None or not _closes(tried[solver].loop):
        return expected
    return (
        f"{expected}: they close to {1e3 * tried[solver].loop.gap:.2g} mm with "
        f"camera='{other}', and so with the hand's poses inverted"
    )

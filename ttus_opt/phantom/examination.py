"""Paths of a probe over a torso: pushes at several places, and sweeps along the body.

A pose is defined by a place on the skin, a depth, two tilts and a turn. Without them
the probe's z axis points into the skin and its x axis (the long one) lies across the
body; the depth is how far the probe reaches below the skin's tangent plane there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import PchipInterpolator
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.torso import Torso
from ttus_opt.probe.trajectory import Trajectory

#: Frames per second [Hz] and duration of a recording [s]
RATE, SECONDS = 20.0, 20.0

#: Pushes: centre (across, along) and half width of the square they lie in [m]
CENTRE, SPREAD = (0.0, 0.13), 0.015

#: Sweeps: lowest and highest z [m]
ALONG = (0.095, 0.205)


@dataclass(frozen=True)
class Handling:
    """The motion of an examiner's hand; all arrays have shape (T,).

    Attributes:
        time: Time [s].
        across: Place on the skin: arc length from the middle of the front [m].
        along: Place on the skin: z [m].
        depth: Depth below the skin's tangent plane, negative when lifted [m].
        rock: Tilt about the body's z axis [rad].
        fan: Tilt about the probe's long axis [rad].
        turn: Rotation about the skin's normal [rad].
    """

    time: Array
    across: Array
    along: Array
    depth: Array
    rock: Array
    fan: Array
    turn: Array

    def poses(self, torso: Torso, probe: EllipsoidProbe) -> Trajectory:
        """The probe's poses over a torso, as a trajectory without a wrench."""
        front = float(torso.radius(np.array(np.pi / 2), np.array(torso.length / 2)))
        theta = np.pi / 2 - self.across / front
        skin = torso.skin(theta, self.along)
        normal = torso.normals(theta, self.along)
        inward = -normal
        long_axis = np.cross(inward, [0.0, 0.0, 1.0])
        long_axis /= np.linalg.norm(long_axis, axis=1, keepdims=True)
        short_axis = np.cross(inward, long_axis)
        level = np.stack([long_axis, short_axis, inward], axis=-1)
        tilt = Rotation.from_euler(
            "zyx", np.column_stack([self.turn, self.rock, self.fan])
        ).as_matrix()
        rotation = level @ tilt
        height = [probe.support(r, n) for r, n in zip(rotation, inward, strict=True)]
        position = skin + normal * (np.asarray(height) - self.depth)[:, None]
        return Trajectory(self.time, position, rotation)


def push_handling(
    rng: np.random.Generator,
    *,
    n_pushes: int = 8,
    deepest: float = 0.013,
) -> Handling:
    """Pushes at several places, with lift-offs, tilting and turning, at `RATE`.

    Args:
        rng: Chooses places, depths and tilts.
        n_pushes: Number of pushes, at least 2.
        deepest: Depth of the deepest push [m]; the others reach at least 60 % of it.

    Raises:
        InputError: Fewer than two pushes.
    """
    if n_pushes < 2:
        raise InputError(f"n_pushes must be at least 2, got {n_pushes}")
    time = np.arange(round(SECONDS * RATE)) / RATE
    phase = time / SECONDS * n_pushes
    number = np.minimum(phase.astype(int), n_pushes - 1)
    peak = deepest * rng.uniform(0.6, 1.0, n_pushes)
    peak[rng.integers(n_pushes)] = deepest
    lift = -0.002
    depth = lift + (peak[number] - lift) * np.sin(np.pi * (phase - number)) ** 2
    # Two stops per push: the hand rests while it presses and moves while lifted.
    stops = np.repeat(np.arange(n_pushes), 2) + np.tile([0.15, 0.85], n_pushes)
    places = [
        np.repeat(c + SPREAD * rng.uniform(-1.0, 1.0, n_pushes), 2) for c in CENTRE
    ]
    drift = [rng.uniform(-0.0015, 0.0015, 2 * n_pushes) for _ in CENTRE]
    across, along = (
        PchipInterpolator(stops, p + d)(np.clip(phase, stops[0], stops[-1]))
        for p, d in zip(places, drift, strict=True)
    )
    return Handling(time, across, along, depth, *_tilts(rng, time, 0.25))


def sweep_handling(
    rng: np.random.Generator,
    *,
    across: float = 0.0,
    depth: tuple[float, float] = (0.004, 0.010),
) -> Handling:
    """One line up the body and one back beside it, with varying depth and tilt.

    Args:
        rng: Chooses phases and frequencies.
        across: Middle between the two lines, which are 5 mm from it [m].
        depth: Smallest and largest depth [m].
    """
    time = np.arange(round(SECONDS * RATE)) / RATE
    phase = time / SECONDS
    way = 0.5 * (1.0 - np.cos(2.0 * np.pi * phase))
    height = ALONG[0] + (ALONG[1] - ALONG[0]) * way
    side = across + 0.005 * np.cos(np.pi * phase)
    side = side + 0.003 * np.sin(_wave(rng, time, 0.25))
    middle, half = sum(depth) / 2, (depth[1] - depth[0]) / 2
    wave = np.sin(_wave(rng, time, 0.17)) + 0.5 * np.sin(_wave(rng, time, 0.41))
    return Handling(
        time, side, height, middle + half * wave / 1.5, *_tilts(rng, time, 0.25)
    )


def _tilts(
    rng: np.random.Generator, time: Array, largest: float
) -> tuple[Array, Array, Array]:
    """Rock, fan and turn over time, each a slow wave [rad]."""
    rock, fan = (largest * np.sin(_wave(rng, time, 0.3)) for _ in range(2))
    return rock, fan, 2.0 * largest * np.sin(_wave(rng, time, 0.07))


def _wave(rng: np.random.Generator, time: Array, frequency: float) -> Array:
    """Phase of a wave with random start and within 20 % of a frequency [Hz] [rad]."""
    around = frequency * rng.uniform(0.8, 1.2)
    return np.asarray(2.0 * np.pi * (around * time + rng.uniform()))

"""Are measured forces zero in air, and do they begin on the skin?

A sensor that touches nothing shows no force. Forces begin where the probe meets the
skin: a scan that is registered a few millimetres off has them begin above or below it,
which no field that is zero on the skin explains. Near the onset the normal force is

    f ≈ k sᵇ with s = w log(1 + exp((d + h) / w)),

with d the depth of the probe's deepest point, negative in air, and h the height of the
onset above the skin. A tracker's errors of depth round the onset over w. Errors are of
the sensor, of stiffness that varies, and of depth; h is the mode of its posterior.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import expit

from ttus_opt.contact.scene import Scene
from ttus_opt.contact.standing import deepest
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import MistakeWarning, warn
from ttus_opt.fitting.checks.late_touch import late_touch, tell_late_touch
from ttus_opt.gaussian.posterior_mode import posterior_mode

#: Share of the frames in air, those farthest from the skin, that surely touch nothing
FAR = 1 / 3

#: Mean force of a sensor that touches nothing, and that over its standard error, above
#: which it was not zeroed [N], [–]
BIAS, CERTAIN_BIAS = 0.1, 10.0

#: Least mean force in the farther half of these frames over that in all [–]
EVEN = 0.7

#: Least and largest height that is taken for an error of registration [m], and by how
#: much its log posterior must exceed that of the least
LEAST_OFFSET, LARGEST_OFFSET, CERTAIN_OFFSET = 1e-3, 15e-3, 4.5

#: So many frames must lie within this below and above the onset [–], [m]
SEEN, NEAR = 10, 2e-3

#: Least exponent of an onset below the skin: depths with large errors look like an
#: onset that is steeper than any contact's, below where it is [–]
LEAST_EXPONENT = 1.2

#: Most frames that the onset is sought in [–]
MOST_FRAMES = 1000

#: Median and logarithmic deviation of the priors of k, in units of a first guess, of
#: the exponent, 1.4 to 1.8 for probes of 1 to 3 cm on torsos of 5 to 60 kPa, and of a
#: depth's error [mm]
MEDIANS, DEVIATIONS = np.log([1.0, 1.6, 0.3]), np.array([3.0, 0.2, 1.0])

#: Standard deviation of the height, and heights where the search starts [mm]
SPREAD, STARTS = 4.0, np.arange(-14.0, 15.0, 2.0)

#: Relative error of a force, by stiffness that varies [–], and least noise [N]
VARIED, LEAST_NOISE = 0.3, 0.02

#: Degrees of freedom of the errors, heavy tails [–]
FREEDOM = 4.0

#: Width of a logistic distribution of deviation 1 [–]
LOGISTIC = 0.55

#: Least s, where the force is nothing [mm]
TINY = 1e-9

#: Most evaluations of the posterior
CALLS = 400


class SensorBias(NamedTuple):
    """What a sensor shows that touches nothing, in the probe's axes.

    Attributes:
        force: Shape (3,) [N].
        torque: Shape (3,) [N·m]; zero where none was measured.
        frames: Number of frames that tell it.
    """

    force: Array
    torque: Array
    frames: int


def on_zero(scene: Scene) -> Scene:
    """The scene without the sensor's bias, its skin where forces begin.

    A `MistakeWarning` tells of both.
    """
    bias = sensor_bias(scene)
    if bias is not None:
        _tell_bias(bias, "It is taken off for this fit")
        turn, measured = scene.trajectory.rotation, scene.trajectory
        force, torque = measured.force, measured.torque
        zeroed = replace(
            measured,
            force=None if force is None else force - turn @ bias.force,
            torque=None if torque is None else torque - turn @ bias.torque,
        )
        scene = scene.measuring(zeroed)
    height = _told_height(scene, "The skin is moved there for this fit")
    return scene if height is None else scene.raised(height)


def warn_of_zero(scene: Scene) -> None:
    """Warn of a sensor that was not zeroed, or a skin that is not where forces begin.

    A fit without a formulation corrects them (`on_zero`).
    """
    bias = sensor_bias(scene)
    if bias is not None:  # where forces begin, it hides
        _tell_bias(bias, "Take its bias off with ttus-opt compensate")
    else:
        _told_height(scene, "A fit without a formulation moves the skin there")


def _told_height(scene: Scene, remedy: str) -> float | None:
    """Height above the skin where forces begin, with a warning [m]; None for none."""
    height = skin_offset(scene)
    if height is not None:
        _tell_offset(height, remedy)
        return height
    height = late_touch(scene)
    if height is not None:
        tell_late_touch(height, remedy)
    return height


def sensor_bias(scene: Scene) -> SensorBias | None:
    """The bias of a sensor; None where it has none, or where nothing tells."""
    measured, air = scene.trajectory, np.flatnonzero(~scene.touching)
    if not measured.has_wrench or not len(air):
        return None
    air = air[:: -(-len(air) // MOST_FRAMES)]
    depth, _ = _deepest(scene, air)
    air = air[np.argsort(depth)][: int(np.ceil(FAR * len(air)))]
    if len(air) < 4:
        return None

    def own(vectors: Array) -> Array:
        turn = measured.rotation[air]
        return np.asarray(np.einsum("tij,ti->tj", turn, vectors[air]))

    shown = own(scene.f.reshape(-1, 3))
    force, error = shown.mean(axis=0), shown.std(axis=0) / np.sqrt(len(air))
    if np.linalg.norm(force) <= max(BIAS, CERTAIN_BIAS * float(np.linalg.norm(error))):
        return None
    half = len(air) // 2  # a low skin's forces are none in the farther half
    if np.linalg.norm(shown[:half].mean(axis=0)) < EVEN * np.linalg.norm(force):
        return None
    torque = np.zeros(3)
    if measured.torque is not None:
        torque = own(measured.torque).mean(axis=0)
    return SensorBias(force, torque, len(air))


def skin_offset(scene: Scene) -> float | None:
    """Height above the skin where forces begin [m], negative below it.

    Args:
        scene: A scene with measured forces.

    Returns:
        The height; None where it is not surely more than `LEAST_OFFSET`, the
        recordings do not show where forces begin, or the sensor was not zeroed.
    """
    measured = scene.trajectory.force
    if measured is None or sensor_bias(scene) is not None:
        return None
    count = len(scene.trajectory)
    frames = np.arange(0, count, -(-count // MOST_FRAMES))
    depth, out = _deepest(scene, frames)
    force = np.einsum("ti,ti->t", out, measured[frames])
    found = _onset(1e3 * depth, force, _noise(measured, scene.trajectory.segment))
    if found is None:
        return None
    past = depth + found
    sides = [((a > 0.0) & (a < NEAR)).sum() for a in (past, -past)]
    return found if min(sides) >= SEEN else None


def _tell_bias(bias: SensorBias, remedy: str) -> None:
    x, y, z = bias.force
    warn(
        f"the sensor shows ({x:z.2f}, {y:z.2f}, {z:z.2f}) N in the probe's axes in "
        f"{bias.frames} frames that touch nothing: was it zeroed? {remedy}",
        3,
        MistakeWarning,
    )


def _tell_offset(height: float, remedy: str) -> None:
    side = "above" if height > 0 else "below"
    warn(
        f"forces begin {1e3 * abs(height):.1f} mm {side} the skin: are the recordings "
        f"registered with the scan, and the probe's shape right? {remedy}",
        4,
        MistakeWarning,
    )


def _deepest(scene: Scene, frames: IntArray) -> tuple[Array, Array]:
    """Depth of the deepest points [m], and the direction out of the skin there."""
    rotation = scene.trajectory.rotation[frames]
    position = scene.trajectory.position[frames]
    depth, point = deepest(scene.voxmap.surface, scene.shell, rotation, position)
    return depth, np.einsum("tij,tj->ti", rotation, scene.shell.normals[point])


def _noise(force: Array, segment: IntArray) -> float:
    """Noise of a force's component, from its second differences in time [N]."""
    joined = segment[2:] == segment[:-2]
    rough = (force[2:] - 2.0 * force[1:-1] + force[:-2])[joined]
    if not len(rough):
        return LEAST_NOISE
    return max(LEAST_NOISE, 1.4826 * float(np.median(np.abs(rough)) / np.sqrt(6.0)))


def _onset(depth: Array, force: Array, noise: float) -> float | None:
    """Height of the onset [m]; None where it is not surely off the skin.

    Args:
        depth: Of the deepest points, shape (t,) [mm].
        force: Normal forces, shape (t,) [N].
        noise: Of a force [N].
    """

    def usual(height: float) -> float:
        """K of the usual exponent, by the frames well past an onset."""
        past = depth + height
        beyond = past > 1e3 * NEAR
        exponent = np.exp(MEDIANS[1])
        ratios: Array = force[beyond] / past[beyond] ** exponent
        return max(float(np.median(ratios)), 1e-6) if beyond.any() else 1e-6

    def parameters(steps: Array) -> tuple[float, float, float]:
        k, exponent, error = np.exp(MEDIANS + DEVIATIONS * steps).tolist()
        return first * k, exponent, error

    def log_likelihood(height: float, steps: Array) -> float:
        k, exponent, error = parameters(steps)
        width = LOGISTIC * error
        s = np.maximum(width * np.logaddexp(0.0, (depth + height) / width), TINY)
        mean = k * s**exponent
        slope = exponent * mean / s * expit((depth + height) / width)
        variance = noise**2 + (VARIED * mean) ** 2 + (error * slope) ** 2
        tails = np.log1p((force - mean) ** 2 / variance / FREEDOM)
        return -0.5 * float((np.log(variance) + (FREEDOM + 1.0) * tails).sum())

    first = usual(0.0)
    starts = [
        np.array([np.log(usual(at) / first) / DEVIATIONS[0], 0.0, 0.0, at / SPREAD])
        for at in STARTS
    ]
    free = posterior_mode(
        lambda x: log_likelihood(SPREAD * x[3], x[:3]), 4, CALLS, starts
    )
    height = SPREAD * float(free.steps[3])
    least = float(np.copysign(1e3 * LEAST_OFFSET, height))
    held = posterior_mode(
        lambda x: log_likelihood(least, x), 3, CALLS, [free.steps[:3]]
    )
    gain = free.log_posterior - held.log_posterior + 0.5 * (least / SPREAD) ** 2
    rounded = height < 0.0 and parameters(free.steps[:3])[1] < LEAST_EXPONENT
    within = 1e3 * LEAST_OFFSET < abs(height) < 1e3 * LARGEST_OFFSET
    return 1e-3 * height if within and gain > CERTAIN_OFFSET and not rounded else None

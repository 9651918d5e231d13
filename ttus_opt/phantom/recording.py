"""Press a whole trajectory into the skin; add noise of the sensor and the tracker."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.phantom.elasticity import SkinPatch
from ttus_opt.phantom.press import CoulombDrag, Motion, press
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.probe.trajectory import Trajectory

#: Noise of the force and torque sensor, standard deviation per axis [N], [N m]
FORCE_NOISE, TORQUE_NOISE = 0.08, 0.003


def record(
    patch: SkinPatch,
    probe: EllipsoidProbe,
    poses: Trajectory,
    *,
    drag: CoulombDrag | None = None,
    damping: float = 0.0,
    moving: Trajectory | None = None,
    progress: Callable[[], None] | None = None,
) -> Trajectory:
    """Press the probe along a trajectory and record the wrench without noise.

    Args:
        patch: Skin and its compliance.
        probe: The rigid probe.
        poses: The poses; a wrench is replaced.
        drag: Coulomb drag, if any.
        damping: Hunt–Crossley coefficient of the tissue, see `press` [s/m].
        moving: Trajectory that gives the velocities, by default ``poses``.
        progress: Called after every pose.

    Returns:
        The trajectory with force [N] and torque about the probe's centre [N m].

    Raises:
        GeometryError: A pose is not above the patch, see `press`.
    """
    moved = poses if moving is None else moving
    velocity, turning = moved.velocity(), moved.angular_velocity()
    force, torque = np.zeros((len(poses), 3)), np.zeros((len(poses), 3))
    for m in range(len(poses)):
        contact = press(
            patch,
            probe,
            poses.rotation[m],
            poses.position[m],
            motion=Motion(velocity[m], turning[m]),
            drag=drag,
            damping=damping,
        )
        force[m], torque[m] = contact.force, contact.torque
        if progress is not None:
            progress()
    return replace(poses, force=force, torque=torque)


#: An ordinary tracker
ORDINARY = TrackerNoise()


def add_noise(trajectory: Trajectory, rng: np.random.Generator) -> Trajectory:
    """A copy with independent normal `FORCE_NOISE` and `TORQUE_NOISE`.

    Raises:
        InputError: The trajectory has no wrench.
    """
    if trajectory.force is None or trajectory.torque is None:
        raise InputError("the trajectory has no wrench to add noise to: record it")
    # frame by frame, so that the noise does not depend on the number of later frames
    noise = rng.standard_normal((len(trajectory), 6))
    return replace(
        trajectory,
        force=trajectory.force + FORCE_NOISE * noise[:, :3],
        torque=trajectory.torque + TORQUE_NOISE * noise[:, 3:],
    )


def add_pose_noise(
    trajectory: Trajectory,
    rng: np.random.Generator,
    noise: TrackerNoise = ORDINARY,
) -> Trajectory:
    """The trajectory as a tracker reports it; the wrench remains that of true poses.

    Args:
        trajectory: One recording with even time steps.
        rng: Source of the noise.
        noise: How large its errors are, and how long they stay alike.
    """
    white = rng.standard_normal((len(trajectory), 6))
    unit = _correlated(white, trajectory.time, noise.correlation)
    return noise.without(trajectory, -unit)


def _correlated(white: Array, time: Array, correlation: float) -> Array:
    """A stationary first-order Gauss–Markov process of unit variance, (T, k)."""
    from scipy.signal import lfilter

    if correlation == 0.0 or len(white) < 2:
        return white
    kept = np.exp(-(time[1] - time[0]) / correlation)
    driven = np.sqrt(1.0 - kept**2) * white
    driven[0] = white[0]
    return np.asarray(lfilter([1.0], [1.0, -kept], driven, axis=0))

"""A whole trajectory pressed into the skin, with a sensor's noise on request."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ttus_opt.errors import InputError
from ttus_opt.phantom.elasticity import SkinPatch
from ttus_opt.phantom.press import CoulombDrag, Motion, press
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.probe.trajectory import Trajectory

#: Noise of the force and torque sensor, standard deviation per axis [N], [N m].
FORCE_NOISE, TORQUE_NOISE = 0.08, 0.003


def record(
    patch: SkinPatch,
    probe: EllipsoidProbe,
    poses: Trajectory,
    *,
    drag: CoulombDrag | None = None,
    progress: Callable[[], None] | None = None,
) -> Trajectory:
    """Press the probe along a trajectory and write down the wrench, free of noise.

    Args:
        patch: Skin and its compliance.
        probe: The rigid probe.
        poses: Its poses; a wrench in it is replaced.
        drag: Coulomb drag along the sliding that follows from the poses.
        progress: Called after every pose.

    Returns:
        The trajectory with force [N] and torque about the probe's centre [N m].

    Raises:
        GeometryError: A pose the patch does not know, see `press`.
    """
    velocity, turning = poses.velocity(), poses.angular_velocity()
    force, torque = np.zeros((len(poses), 3)), np.zeros((len(poses), 3))
    for m in range(len(poses)):
        contact = press(
            patch,
            probe,
            poses.rotation[m],
            poses.position[m],
            motion=Motion(velocity[m], turning[m]),
            drag=drag,
        )
        force[m], torque[m] = contact.force, contact.torque
        if progress is not None:
            progress()
    return replace(poses, force=force, torque=torque)


def add_noise(
    trajectory: Trajectory,
    rng: np.random.Generator,
    *,
    force_std: float = FORCE_NOISE,
    torque_std: float = TORQUE_NOISE,
) -> Trajectory:
    """Add independent normal noise to every component of the wrench.

    Args:
        trajectory: With a wrench.
        rng: Source of the noise.
        force_std: Standard deviation [N].
        torque_std: Standard deviation [N m].

    Returns:
        A noisy copy.

    Raises:
        InputError: The trajectory has no wrench.
    """
    if trajectory.force is None or trajectory.torque is None:
        raise InputError("the trajectory has no wrench to add noise to: record it")
    # Frame by frame: how many follow does not change the first frames' noise.
    noise = rng.standard_normal((len(trajectory), 6))
    return replace(
        trajectory,
        force=trajectory.force + force_std * noise[:, :3],
        torque=trajectory.torque + torque_std * noise[:, 3:],
    )

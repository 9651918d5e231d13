"""Perturbed data: measurements that contradict what a formulation demands.

The example's recordings agree with sign and growth along spokes: no bound is active,
and a solver is never seen at work on them. Perturbed values make tens to hundreds of
limits active, at weights high enough for the field to follow them (``--weight``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttus_opt.errors import InputError
from ttus_opt.probe.trajectory import Trajectory

#: Ways to perturb a recording
PERTURBATIONS = ("noise", "reversed")

#: Standard deviation per axis of the noise added, force [N] and torque [N·m]
FORCE_NOISE, TORQUE_NOISE = 2.0, 0.03

#: Part of the frames whose wrench is turned round [–]
REVERSED_PART = 0.2

#: Of the noise and of the choice of frames: the same for every solver
SEED = 0


def perturbed(trajectory: Trajectory, how: str) -> Trajectory:
    """A recording with perturbed wrenches, the same at every call.

    Args:
        trajectory: With wrenches.
        how: ``noise`` adds Gaussian noise to every force and torque, ``reversed``
            turns the sign of those of a fifth of the frames; "" leaves all as it is.

    Raises:
        InputError: There is no such perturbation, or nothing was measured.
    """
    if not checked_perturbation(how):
        return trajectory
    force, torque = trajectory.force, trajectory.torque
    if force is None or torque is None:
        raise InputError(
            f"perturbation {how!r} changes measured wrenches, but the trajectory has "
            "none: add columns fx, fy, fz, tx, ty, tz"
        )
    rng = np.random.default_rng(SEED)
    if how == "noise":
        return replace(
            trajectory,
            force=force + rng.normal(0.0, FORCE_NOISE, force.shape),
            torque=torque + rng.normal(0.0, TORQUE_NOISE, torque.shape),
        )
    count = max(1, round(REVERSED_PART * len(trajectory)))
    sign = np.ones((len(trajectory), 1))
    sign[rng.choice(len(trajectory), count, replace=False)] = -1.0
    return replace(trajectory, force=sign * force, torque=sign * torque)


def checked_perturbation(how: str) -> str:
    """The perturbation, if there is one of that name or none is asked for.

    Raises:
        InputError: There is none.
    """
    if how and how not in PERTURBATIONS:
        choices = " or ".join(PERTURBATIONS)
        raise InputError(f"unknown perturbation {how!r}: choose {choices}")
    return how

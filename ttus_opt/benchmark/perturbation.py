"""Perturbed data: measurements that conflict with the constraints of a formulation.

The example's recordings are consistent with sign and monotonicity: no bound is active,
and solvers have no constraints to handle. Perturbed values make tens to hundreds of
limits active, at weights high enough for the field to follow them (``--weight``).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory

#: Ways to perturb a recording
PERTURBATIONS = ("noise", "reversed")

#: Standard deviation per axis of the noise added, force [N] and torque [N·m]
FORCE_NOISE, TORQUE_NOISE = 2.0, 0.03

#: Fraction of the frames whose wrench is reversed [–]
REVERSED_PART = 0.2

#: Seed of noise and choice of frames, the same for every solver
SEED = 0


def perturbed(trajectory: Trajectory, how: str) -> Trajectory:
    """A recording with perturbed wrenches, the same at every call.

    Args:
        trajectory: A trajectory with wrenches.
        how: ``noise`` adds Gaussian noise to every force and torque, ``reversed``
            changes the sign in a fifth of the frames; "" does nothing.

    Raises:
        InputError: An unknown perturbation, or no wrenches.
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
    """The perturbation's name or ""; `InputError` if it is unknown."""
    if how and how not in PERTURBATIONS:
        choices = " or ".join(PERTURBATIONS)
        raise InputError(f"unknown perturbation {how!r}: choose {choices}")
    return how

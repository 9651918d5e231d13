"""Hysteresis of recorded presses: the work that is dissipated.

The work done on the patient between two frames is the trapezoidal integral of
−f·dx − τ·dφ, where dx is the displacement of the torques' reference point and dφ the
rotation. From touch to release, an elastic body returns all of this work; tissue, gel
and friction dissipate part of it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory

#: Shortest press that counts [frames]
SHORTEST = 5


def hysteresis_share(
    trajectory: Trajectory, shell: PointShell, force_threshold: float
) -> float:
    """Fraction of the work of complete presses that is dissipated.

    Args:
        trajectory: Poses with forces, and with torques if they were measured.
        shell: The probe.
        force_threshold: Force above which the probe is in contact [N].

    Returns:
        Σ work at release / Σ largest work during a press: 0 for an elastic body, 1 if
        all work is dissipated, NaN if no press begins and ends in the recording.

    Raises:
        InputError: The trajectory has no forces.
    """
    if trajectory.force is None:
        raise InputError("hysteresis needs measured forces: add fx,fy,fz")
    dissipated, done = 0.0, 0.0
    for own in trajectory.recordings:
        work = np.concatenate([[0.0], np.cumsum(_work(own, shell))])
        size = np.linalg.norm(np.asarray(own.force), axis=1)
        for start, stop in _presses(size > force_threshold):
            during = work[start : stop + 1] - work[start]
            dissipated, done = dissipated + during[-1], done + during.max()
    return dissipated / done if done > 0.0 else float("nan")


def _work(trajectory: Trajectory, shell: PointShell) -> Array:
    """Work done on the patient between frames, shape (T - 1,) [J]."""
    rotation, force, torque = trajectory.rotation, trajectory.force, trajectory.torque
    at = trajectory.position + rotation @ np.asarray(shell.reference)
    assert force is not None
    work = -np.einsum("ti,ti->t", force[1:] + force[:-1], np.diff(at, axis=0)) / 2
    if torque is not None:
        turn = Rotation.from_matrix(rotation[1:] @ rotation[:-1].transpose(0, 2, 1))
        mean = (torque[1:] + torque[:-1]) / 2
        work -= np.einsum("ti,ti->t", mean, turn.as_rotvec())
    return np.asarray(work)


def _presses(touching: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """Last frame before and first frame after every complete press."""
    change = np.diff(touching.astype(int))
    starts, stops = np.flatnonzero(change == 1), np.flatnonzero(change == -1) + 1
    pairs = []
    for start in starts:
        after = stops[stops > start]
        if after.size and after[0] - start > SHORTEST:
            pairs.append((int(start), int(after[0])))
    return pairs

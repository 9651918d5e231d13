"""Hysteresis of recorded presses: the work that is not given back.

The work done on the patient between two frames is the trapezoid of −f·dx − τ·dφ, with
dx the way of the point that torques are about and dφ the turn. Over a press, from
touch to release, an elastic body gives back all of it; tissue, gel and friction keep a
share.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ttus_opt.arrays import Array, IntArray
from ttus_opt.errors import InputError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory

#: A press has at least so many frames [–]
SHORTEST = 5


def hysteresis_share(
    trajectory: Trajectory, shell: PointShell, force_threshold: float
) -> float:
    """Share of the work of complete presses that is not given back.

    Args:
        trajectory: Poses with forces, and torques where they were measured.
        shell: The probe.
        force_threshold: The probe touches above this force [N].

    Returns:
        Σ work at release / Σ largest work during a press, 0 for an elastic body and 1
        where nothing comes back; NaN where no press begins and ends in the recording.

    Raises:
        InputError: No forces.
    """
    if trajectory.force is None:
        raise InputError("hysteresis needs measured forces: add fx,fy,fz")
    size = np.linalg.norm(trajectory.force, axis=1)
    kept, spent = 0.0, 0.0
    for number in np.unique(trajectory.segment):
        own = np.flatnonzero(trajectory.segment == number)
        work = np.concatenate([[0.0], np.cumsum(_work(trajectory, shell, own))])
        for start, stop in _presses(size[own] > force_threshold):
            during = work[start : stop + 1] - work[start]
            kept, spent = kept + during[-1], spent + during.max()
    return kept / spent if spent > 0.0 else float("nan")


def _work(trajectory: Trajectory, shell: PointShell, own: IntArray) -> Array:
    """Work done on the patient between frames, shape (T - 1,) [J]."""
    assert trajectory.force is not None
    rotation = trajectory.rotation[own]
    at = trajectory.position[own] + rotation @ np.asarray(shell.reference)
    force = trajectory.force[own]
    work = -np.einsum("ti,ti->t", force[1:] + force[:-1], np.diff(at, axis=0)) / 2
    if trajectory.torque is not None:
        torque = trajectory.torque[own]
        turn = Rotation.from_matrix(rotation[1:] @ rotation[:-1].transpose(0, 2, 1))
        mean = (torque[1:] + torque[:-1]) / 2
        work -= np.einsum("ti,ti->t", mean, turn.as_rotvec())
    return np.asarray(work)


def _presses(touching: NDArray[np.bool_]) -> list[tuple[int, int]]:
    """First frame before and first after every press that begins and ends."""
    change = np.diff(touching.astype(int))
    starts, stops = np.flatnonzero(change == 1), np.flatnonzero(change == -1) + 1
    pairs = []
    for start in starts:
        after = stops[stops > start]
        if after.size and after[0] - start > SHORTEST:
            pairs.append((int(start), int(after[0])))
    return pairs

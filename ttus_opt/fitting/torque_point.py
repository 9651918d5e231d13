"""About which point of the probe were torques measured? What they say of it themselves.

Torques about a point that lies c from the one that was told, in the probe's frame R,
differ by a moment of the force: τ = k τ̂ - (R c) × f, with k τ̂ what the geometry
expects. k and c follow by least squares. A push along one axis of the probe tells
nothing of c along that axis, so that directions which move the torques less than a
tenth as much as the best one does are left at zero.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.arrays import Array

#: Directions of c count whose singular value is at least this share of the largest
TOLD = 0.1


def torque_offset(
    torque: Array, expected: Array, force: Array, rotation: Array
) -> Array:
    """Where torques were measured about, from the point that was told.

    Args:
        torque: Measured, patient axes, shape (T, 3) [N·m].
        expected: What the geometry expects but for a factor, shape (T, 3).
        force: Measured, on the probe, shape (T, 3) [N].
        rotation: Probe to patient, shape (T, 3, 3).

    Returns:
        c, probe frame, shape (3,) [m].
    """
    # f × (R c) per column of R
    arms = np.cross(force[:, None, :], np.swapaxes(rotation, 1, 2))
    columns = np.swapaxes(arms, 1, 2).reshape(-1, 3)
    own, tau = expected.reshape(-1), torque.reshape(-1)
    size = float(np.linalg.norm(own))
    if size > 0.0:  # what a factor k explains is no offset
        unit = own / size
        tau = tau - unit * (unit @ tau)
        columns = columns - np.outer(unit, unit @ columns)
    offset, *_ = np.linalg.lstsq(columns, tau, rcond=TOLD)
    return np.asarray(offset)

"""Disagreement of measured wrenches with those of the Laplace field alone.

S of `fitting.checks.sanity`, and the point about which torques were measured: torques
about a point at c from the assumed one, in the frame R of the probe, differ by the
moment of the force, τ = k τ̂ - (R c) × f, with k τ̂ the expected torque. k and c follow
by least squares. A push along an axis of the probe does not determine c along that
axis: directions with small singular values are left at zero.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.probe.trajectory import Trajectory

#: Least singular value of a direction of c, over the largest [–]
LEAST_SINGULAR_VALUE = 0.1


@dataclass(frozen=True)
class Agreement:
    """S, and the ratio of measured torques to those of the Laplace field [–]."""

    disagreement: float
    torque_ratio: float


def agreement(scene: Scene, prior: Array, frames: Trajectory) -> Agreement:
    """S of some frames; `prior` is p₀, shape (V,)."""
    rows = scene.rows_along(frames)
    assert frames.force is not None
    s, force_left = _scaled(frames.force.reshape(-1), rows.N @ prior)
    if frames.torque is None:
        return Agreement(force_left, 0.0)
    k, torque_left = _scaled(frames.torque.reshape(-1), rows.W @ prior)
    left = math.sqrt(force_left * torque_left)
    return Agreement(left, k / s if s > 0.0 else 0.0)


def torque_offset(
    torque: Array, expected: Array, force: Array, rotation: Array
) -> Array:
    """Offset c of the point about which torques were measured.

    Args:
        torque: Measured torques, patient axes, shape (T, 3) [N·m].
        expected: Expected torques up to a factor, shape (T, 3).
        force: Measured forces on the probe, shape (T, 3) [N].
        rotation: Rotation, probe to patient, shape (T, 3, 3).

    Returns:
        c from the assumed point, probe frame, shape (3,) [m].
    """
    # f × (R c) per column of R
    arms = np.cross(force[:, None, :], np.swapaxes(rotation, 1, 2))
    columns = np.swapaxes(arms, 1, 2).reshape(-1, 3)
    flat, tau = expected.reshape(-1), torque.reshape(-1)
    size = float(np.linalg.norm(flat))
    if size > 0.0:  # project out what the factor k explains
        unit = flat / size
        tau = tau - unit * (unit @ tau)
        columns = columns - np.outer(unit, unit @ columns)
    offset, *_ = np.linalg.lstsq(columns, tau, rcond=LEAST_SINGULAR_VALUE)
    return np.asarray(offset)


def _scaled(measured: Array, expected: Array) -> tuple[float, float]:
    """The best scale ≥ 0, and ‖rest‖²/‖measured‖²; 1 where nothing is expected."""
    size, power = float(measured @ measured), float(expected @ expected)
    if size == 0.0 or power == 0.0:
        return 0.0, float(size > 0.0)
    scale = max(float(measured @ expected) / power, 0.0)
    rest = measured - scale * expected
    return scale, float(rest @ rest) / size

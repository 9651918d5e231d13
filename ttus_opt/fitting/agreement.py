"""How far measured wrenches disagree with those that geometry expects.

S of `ttus_opt.fitting.sanity`, from the Laplace field alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from ttus_opt.arrays import Array
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scene import Scene


@dataclass(frozen=True)
class Agreement:
    """S, and how much larger torques are than those of the Laplace field [–]."""

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


def _scaled(measured: Array, expected: Array) -> tuple[float, float]:
    """The scale ≥ 0 that fits best, and ‖rest‖²/‖measured‖²; 1 where nothing is."""
    size, own = float(measured @ measured), float(expected @ expected)
    if size == 0.0 or own == 0.0:
        return 0.0, float(size > 0.0)
    scale = max(float(measured @ expected) / own, 0.0)
    rest = measured - scale * expected
    return scale, float(rest @ rest) / size

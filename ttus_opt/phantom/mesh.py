"""Structured hexahedral meshes: graded node positions and closed rings."""

from __future__ import annotations

from typing import Any

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.core.optional import load


def graded(
    low: float,
    high: float,
    fine: tuple[float, float],
    step: float,
    growth: float = 1.35,
    largest: float = np.inf,
) -> Array:
    """Node positions with even steps within ``fine`` that grow towards both ends.

    Args:
        low: First node.
        high: Last node.
        fine: Interval of even steps, within [low, high].
        step: Step in ``fine``, rounded so that it divides the interval.
        growth: Ratio of neighbouring steps outside, above 1.
        largest: Largest step outside.

    Returns:
        Increasing positions, shape (n,), in the unit of the arguments.

    Raises:
        InputError: The limits are out of order, or step or growth give no mesh.

    Examples:
        >>> graded(0.0, 10.0, (0.0, 2.0), 1.0, growth=2.0).round(3).tolist()
        [0.0, 1.0, 2.0, 4.667, 10.0]
    """
    if not (low <= fine[0] < fine[1] <= high) or step <= 0.0 or growth <= 1.0:
        raise InputError(
            f"cannot grade [{low}, {high}] with {fine} fine at step {step} and growth "
            f"{growth}: expected low <= fine[0] < fine[1] <= high, step > 0, growth > 1"
        )
    n_fine = max(round((fine[1] - fine[0]) / step), 1)
    middle = np.linspace(*fine, n_fine + 1)
    below = _growing(fine[0] - low, step, growth, largest)
    above = _growing(high - fine[1], step, growth, largest)
    nodes = np.concatenate([fine[0] - below[::-1], middle, fine[1] + above])
    nodes[[0, -1]] = low, high  # exact: boundary conditions compare with them
    return nodes


def _growing(length: float, step: float, growth: float, largest: float) -> Array:
    """Positions after growing steps that add up to ``length``, without the zero."""
    if length < 1e-9 * step:
        return np.empty(0)
    steps = [min(step * growth, largest)]
    while sum(steps) < length - 0.5 * steps[-1]:
        steps.append(min(steps[-1] * growth, largest))
    positions = np.cumsum(steps)
    return np.asarray(positions * (length / positions[-1]))


def ring_mesh(fraction: Array, theta: Array, z: Array, points: Any) -> Any:
    """Hexahedra around an axis that close to a ring.

    Args:
        fraction: Radial coordinate of the nodes, increasing, shape (n_r,) [–].
        theta: Angles of one full turn with both ends, shape (n_theta + 1,) [rad].
        z: Heights, shape (n_z,) [m].
        points: Maps (fraction, θ, z), each (n,), to points (n, 3) [m].

    Returns:
        A `skfem.MeshHex` whose nodes are in C order of (n_r, n_theta, n_z).

    Raises:
        InputError: The angles do not span one full turn.
    """
    MeshHex = load("skfem", "phantom").MeshHex
    if abs(theta[-1] - theta[0] - 2.0 * np.pi) > 1e-9:
        raise InputError(
            f"theta must span one full turn, got {theta[-1] - theta[0]:.6g} rad"
        )
    # A box in index space gives the connectivity; its last angle is the first one.
    indices = [np.arange(float(len(v))) for v in (fraction, theta, z)]
    box = MeshHex.init_tensor(*indices)
    i, j, k = np.rint(box.p).astype(int)
    n_theta, n_z = len(theta) - 1, len(z)
    number = (i * n_theta + j % n_theta) * n_z + k
    grid = np.meshgrid(fraction, theta[:-1], z, indexing="ij")
    nodes = points(*(axis.reshape(-1) for axis in grid))
    return MeshHex(np.ascontiguousarray(nodes.T), np.ascontiguousarray(number[box.t]))

"""The ellipse-like outline that replaces the unseen part of a body.

One conic per height, q₁x² + q₂xy + q₃y² + q₄x + q₅y = 1 with coefficients linear in z,
fitted by least squares to three kinds of data: the seen radii; contact with the
supporting plane, if one is known; and, with a small weight, that an unseen spoke is
about as long as the opposite one. The last keeps the conic an ellipse when little was
seen.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array

_CONTACT_WEIGHT = 0.3  # of all contact points together, relative to all seen radii
_OPPOSITE_WEIGHT = 0.1  # of one unseen spoke, relative to one seen


def outline(
    radius: Array, observed: NDArray[np.bool_], limit: Array | None = None
) -> Array:
    """Radius of the outline on the nodes of a surface.

    Args:
        radius: Radii, meaningful where observed, shape (n_theta, n_z) [m].
        observed: Where a radius was seen, same shape; somewhere at least.
        limit: Where each spoke meets the supporting plane, inf where it does not,
            same shape [m]; None when no plane is known.

    Returns:
        Radii, same shape [m]; within half and twice the median of the seen ones,
        and nowhere beyond the limit.
    """
    n_theta, n_z = radius.shape
    most = np.full(radius.shape, np.inf) if limit is None else limit
    theta = np.broadcast_to(
        np.arange(n_theta)[:, None] * (2 * np.pi / n_theta), radius.shape
    )
    height = np.broadcast_to(np.linspace(-0.5, 0.5, n_z), radius.shape)
    scale = float(np.median(radius[observed]))
    n_seen, unseen = observed.sum(), ~observed
    known = [(_terms(radius / scale, theta, height)[observed], 1.0)]
    if unseen.any():
        seen = np.where(observed, radius, scale)
        opposite = np.minimum(np.roll(seen, n_theta // 2, axis=0), most)
        rows = _terms(opposite / scale, theta, height)[unseen]
        known.append((rows, _OPPOSITE_WEIGHT))
    touching = np.flatnonzero(np.isfinite(most).any(axis=0))
    if touching.size:
        foot = np.argmin(most[:, touching], axis=0), touching
        rows = _terms(most[foot] / scale, theta[foot], height[foot])
        known.append((rows, _CONTACT_WEIGHT * n_seen / len(rows)))
    A = np.concatenate([np.sqrt(weight) * rows for rows, weight in known])
    one = np.concatenate([np.full(len(rows), np.sqrt(w)) for rows, w in known])
    q, *_ = np.linalg.lstsq(A, one, rcond=1e-6)
    # On a spoke the conic is a ρ² + b ρ = 1; the terms at ρ = 1 hold both parts.
    unit = _terms(np.ones(radius.shape), theta, height)
    a = unit[..., :6] @ q[:6]
    b = unit[..., 6:] @ q[6:]
    root = np.sqrt(np.maximum(b**2 + 4 * a, 0.0))
    rho = 2.0 / np.maximum(b + root, 1e-3)  # open towards a spoke: cut off below
    return np.asarray(np.minimum(scale * np.clip(rho, 0.5, 2.0), most))


def _terms(rho: Array, theta: Array, height: Array) -> Array:
    """x², xy, y² and x, y, each also times the height, shape (…, 10) [–]."""
    x, y = rho * np.cos(theta), rho * np.sin(theta)
    square, linear = [x * x, x * y, y * y], [x, y]
    return np.stack(
        [
            *square,
            *(s * height for s in square),
            *linear,
            *(s * height for s in linear),
        ],
        axis=-1,
    )

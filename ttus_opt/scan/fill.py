"""The unseen part of a surface, filled smoothly.

The difference u between the radius and an ellipse-like outline of the body
(`outline`) is a thin plate on an elastic foundation over the unrolled
surface, periodic in θ and free at both ends: it minimises
Σ (u − u_seen)²/variance + (∫ bending + u²/ℓ⁴)/c². It continues the seen part smoothly
and returns to the outline over the length ℓ. The surface cannot lie behind a supporting
plane: where the plate would pass through it, the unseen part is held at the plane. The
plate also smooths the seen part, within its standard deviation.

The outline is one conic per height, q₁x² + q₂xy + q₃y² + q₄x + q₅y = 1 with
coefficients linear in z, fitted by least squares to three kinds of data: the seen
radii; contact with the supporting plane, if one is known; and, with a small weight,
that an unseen spoke is about as long as the opposite one. The last keeps the conic an
ellipse when little was seen.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import spsolve

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


#: Scale c of the plate's curvature, as the deviation of white noise [1/m · m].
CURVATURE = 0.4
#: Length ℓ over which the plate returns to the outline [m].
RETURN_LENGTH = 0.03
#: Limit s and length ℓ of an unseen radius' deviation s (1 − e^(−ρ/ℓ)) at the distance
#: ρ from the seen part, on a supporting plane and without one [m]: fitted to errors on
#: a CT torso and a depth camera's scan with sides hidden (docs/method/surface.md, 2.4)
ON_PLANE, WITHOUT_PLANE = (0.020, 0.045), (0.060, 0.130)
_LEAST_RADIUS = 0.02  # [m]
_HELD_STD = 0.002  # of a radius held at the supporting plane [m]


def fill_smoothly(
    radius: Array,
    variance: Array,
    observed: NDArray[np.bool_],
    *,
    z_step: float,
    limit: Array | None = None,
) -> tuple[Array, Array]:
    """Fill the unobserved part.

    Args:
        radius: Radii, meaningful where observed, shape (n_theta, n_z) [m].
        variance: Their variance there, same shape [m²].
        observed: Where a radius was seen, same shape.
        z_step: Distance between slices [m].
        limit: Largest possible radius (the support), same shape; inf for none [m].

    Returns:
        Radius and its standard deviation everywhere, shape (n_theta, n_z) [m]. The
        deviation grows with the distance from the seen part, to 20 mm where a
        supporting plane is known and to 60 mm where none is.
    """
    shape = radius.shape
    arc = float(np.median(radius[observed])) * 2.0 * np.pi / shape[0]
    stiffness = _bending(shape, arc, z_step)
    stiffness += arc * z_step / RETURN_LENGTH**4 * sp.eye_array(radius.size)
    stiffness /= CURVATURE**2
    base = outline(radius, observed, limit).reshape(-1)
    seen = observed.reshape(-1)
    weight = np.where(seen, 1.0 / variance.reshape(-1), 0.0)
    data = np.where(seen, radius.reshape(-1) - base, 0.0)
    room = np.full(seen.size, np.inf) if limit is None else limit.reshape(-1) - base
    for _ in range(4):
        matrix = (stiffness + sp.diags_array(weight)).tocsc()
        plate = np.asarray(spsolve(matrix, weight * data))
        through = ~seen & (weight == 0) & (plate > room + 5e-4)
        if not through.any():
            break
        weight = np.where(through, 1.0 / _HELD_STD**2, weight)
        data = np.where(through, room, data)
    solution = base + np.where(seen, plate, np.minimum(plate, room))
    growth = WITHOUT_PLANE if limit is None else ON_PLANE
    std = _std(variance, observed, (arc, z_step), growth)
    return np.maximum(solution, _LEAST_RADIUS).reshape(shape), std


def _differences(
    n: int, step: float, *, periodic: bool
) -> tuple[sp.csr_array, sp.csr_array]:
    """First derivative between neighbouring nodes, second at those with two."""
    rows = n if periodic else n - 1
    here, after = np.arange(rows), (np.arange(rows) + 1) % n
    ends = np.repeat([-1.0 / step, 1.0 / step], rows), np.r_[here, after]
    D = sp.csr_array((ends[0], (np.r_[here, here], ends[1])), shape=(rows, n))
    inner = slice(None) if periodic else slice(1, n - 1)
    return D, sp.csr_array(-(D.T @ D))[inner]


def _bending(shape: tuple[int, ...], arc: float, z_step: float) -> sp.csr_array:
    """Matrix of the bending energy ∫ R_tt² + 2 R_tz² + R_zz² (t the arc length)."""
    n_theta, n_z = shape
    eye_t, eye_z = sp.eye_array(n_theta), sp.eye_array(n_z)
    t, second_t = _differences(n_theta, arc, periodic=True)
    z, second_z = _differences(n_z, z_step, periodic=False)
    tt, zz, tz = sp.kron(second_t, eye_z), sp.kron(eye_t, second_z), sp.kron(t, z)
    area = arc * z_step
    return sp.csr_array(area * (tt.T @ tt + 2.0 * tz.T @ tz + zz.T @ zz))


def _std(
    variance: Array,
    observed: NDArray[np.bool_],
    steps: tuple[float, float],
    growth: tuple[float, float],
) -> Array:
    """Deviation: the filter's where observed, growing with distance elsewhere."""
    from scipy.ndimage import distance_transform_edt

    n = len(observed)
    half = n // 2 + 1  # wrap around: half a turn on either side
    wrapped = np.concatenate([observed[-half:], observed, observed[:half]])
    edge = np.sqrt(np.median(variance[observed]))
    distance = distance_transform_edt(~wrapped, sampling=steps)[half : half + n]
    most, length = growth
    grown = np.hypot(edge, -most * np.expm1(-distance / length))
    return np.where(observed, np.sqrt(variance), grown)

"""Which pixels of a depth image show a surface, and at what angle it is seen.

Around every pixel a plane is fitted to its neighbours on the same surface. Seen by a
camera, a plane A X + B Y + C Z = 1 is 1/Z = A x + B y + C with x = X/Z and y = Y/Z:
linear in the inverse depth, whatever the rays. A neighbour is on another surface when
its depth differs by more than noise and the steepest accepted surface can explain.

A flying pixel lies between two surfaces, where the camera mixed their depths: an
adjacent pixel is on another surface, or few of its neighbours are on its own. The
outermost pixels of a surface cannot be told from mixed ones, so they count as flying.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array

#: Half width of the window: wide enough to average noise, small enough that a body is
#: flat in it [m]
REACH = 0.010

#: Neighbours on either side of a pixel, in rows and in columns
STEPS = 2

#: A neighbour more standard deviations away than this is on another surface
GATE = 4.0

#: Standard deviation without a noise model, as a fraction of the depth [–]
USUAL_NOISE = 0.003

#: Least fraction of the measured neighbours, and least number, on a pixel's own surface
LEAST_SHARE, LEAST_COUNT = 0.4, 6


@dataclass(frozen=True)
class Judged:
    """What the neighbourhood of every pixel shows.

    Attributes:
        flying: Between two surfaces, at the edge of one, or isolated, shape (height,
            width).
        incidence: Angle between ray and surface normal, same shape [rad]; NaN where
            flying or not measured.
    """

    flying: NDArray[np.bool_]
    incidence: Array


def judge(z: Array, rays: Array, focal: float, noise: Array, steepest: float) -> Judged:
    """Fit a plane around every pixel.

    Args:
        z: Depth along the optical axis, NaN where not measured, (height, width) [m].
        rays: Unit vectors of the pixels, shape (height, width, 3) [–].
        focal: Focal length [pixel].
        noise: Standard deviation of z, same shape as it [m].
        steepest: Largest angle of incidence that is kept [rad].
    """
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    stride = max(1, round(REACH * focal / float(np.nanmedian(z)) / STEPS))
    slope = np.tan(steepest) / focal
    edge = np.zeros(z.shape, dtype=bool)
    for there, here, steps in _neighbours(z.shape, 1, 1):
        room = GATE * np.sqrt(2.0) * noise[here] + steps * slope * z[here]
        edge[here] |= np.abs(z[there] - z[here]) > room  # NaN is not a neighbour
    sums = np.zeros((10, *z.shape))  # 1, x, y, w, xx, xy, yy, xw, yw, all there are
    for there, here, steps in _neighbours(z.shape, STEPS, stride):
        dz = z[there] - z[here]
        seen = np.isfinite(dz)
        room = GATE * np.sqrt(2.0) * noise[here] + steps * slope * z[here]
        near = seen & (np.abs(dz) <= room)
        dx = np.where(near, x[there] - x[here], 0.0)
        dy = np.where(near, y[there] - y[here], 0.0)
        dw = np.where(near, 1.0 / z[there] - 1.0 / z[here], 0.0)
        terms = (near, dx, dy, dw, dx * dx, dx * dy, dy * dy, dx * dw, dy * dw, seen)
        for total, term in zip(sums, terms, strict=True):
            total[here] += term
    count, present = sums[0], sums[9]
    measured = np.isfinite(z)
    alone = (count < LEAST_SHARE * present) | (count < LEAST_COUNT)
    flying = measured & (alone | edge)
    incidence = _incidence(sums, x, y, 1.0 / z)
    return Judged(flying, np.where(measured & ~flying, incidence, np.nan))


def _neighbours(
    shape: tuple[int, ...], most: int, stride: int
) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice], float]]:
    """Slices of neighbours and of their pixels, and the distance between them [pixel].

    Neighbours are up to ``most`` strides away in rows and columns, the pixel included.
    """

    def pair(step: int, side: int) -> tuple[slice, slice]:
        step = int(np.clip(step, -side, side))
        ahead, behind = slice(max(step, 0), side + min(step, 0)), max(-step, 0)
        return ahead, slice(behind, side - max(step, 0))

    for i in range(-most, most + 1):
        for j in range(-most, most + 1):
            rows, own_rows = pair(i * stride, shape[0])
            columns, own_columns = pair(j * stride, shape[1])
            distance = stride * float(np.hypot(i, j))
            yield (rows, columns), (own_rows, own_columns), distance


def _incidence(sums: Array, x: Array, y: Array, w: Array) -> Array:
    """Angle between ray and normal of the plane 1/Z = A x + B y + C [rad]."""
    n = np.maximum(sums[0], 1.0)
    mx, my, mw = sums[1] / n, sums[2] / n, sums[3] / n
    xx, xy, yy = sums[4] / n - mx**2, sums[5] / n - mx * my, sums[6] / n - my**2
    xw, yw = sums[7] / n - mx * mw, sums[8] / n - my * mw
    determinant = xx * yy - xy**2
    # neighbours on a line determine no plane
    flat = determinant > 1e-3 * (0.5 * (xx + yy)) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        A = (yy * xw - xy * yw) / determinant
        B = (xx * yw - xy * xw) / determinant
        fitted = w + mw - A * mx - B * my  # 1/Z of the plane on the pixel's own ray
        C = fitted - A * x - B * y
        length = np.sqrt(A**2 + B**2 + C**2) * np.sqrt(x**2 + y**2 + 1.0)
        cosine = np.clip(fitted / length, 0.0, 1.0)
    return np.asarray(np.where(flat, np.arccos(cosine), np.pi / 2))

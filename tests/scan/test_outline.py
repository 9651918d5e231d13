"""The outline: exact for conics, held by the plane, an ellipse from half of one."""

import numpy as np

from ttus_opt.scan.outline import outline

N_THETA, N_Z = 72, 7
THETA = np.arange(N_THETA)[:, None] * (2 * np.pi / N_THETA)
ALL = np.ones((N_THETA, N_Z), dtype=bool)


def ellipse(a=0.16, b=0.11):
    radius = 1.0 / np.sqrt((np.cos(THETA) / a) ** 2 + (np.sin(THETA) / b) ** 2)
    return np.broadcast_to(radius, (N_THETA, N_Z)).copy()


def test_an_ellipse_is_its_own_outline():
    np.testing.assert_allclose(outline(ellipse(), ALL), ellipse(), rtol=1e-9)
    # off its centre it is a conic with linear terms
    x, y = 0.13 * np.cos(THETA) + 0.02, 0.13 * np.sin(THETA) - 0.01
    away = np.hypot(x, y)
    turned = np.interp(THETA[:, 0], np.arctan2(y, x)[:, 0] % (2 * np.pi), away[:, 0],
                       period=2 * np.pi)  # fmt: skip
    radius = np.broadcast_to(turned[:, None], ALL.shape).copy()
    np.testing.assert_allclose(outline(radius, ALL), radius, rtol=2e-3)


def test_half_an_ellipse_is_enough():
    seen = np.broadcast_to(np.sin(THETA) > -0.2, ALL.shape)
    radius = np.where(seen, ellipse(), np.nan_to_num(np.nan, nan=7.0))
    found = outline(radius, seen)
    np.testing.assert_allclose(found[seen], ellipse()[seen], rtol=0.02)
    np.testing.assert_allclose(found[~seen], ellipse()[~seen], rtol=0.1)


def test_nothing_lies_beyond_the_plane_and_it_is_touched():
    """A plane 9 cm under the axis, the back unseen: the outline reaches it."""
    seen = np.broadcast_to(np.sin(THETA) > 0.0, ALL.shape)
    down = -np.sin(THETA)
    limit = np.where(down > 0.1, 0.09 / np.maximum(down, 0.1), np.inf)
    limit = np.broadcast_to(limit, ALL.shape)
    found = outline(np.where(seen, ellipse(), 1.0), seen, limit)
    assert (found <= limit).all()
    lowest = (found * down).max(axis=0)
    np.testing.assert_allclose(lowest, 0.09, rtol=0.03)


def test_it_stays_within_half_and_twice_the_median():
    seen = np.zeros_like(ALL)
    seen[:5] = True  # next to nothing was seen
    wild = np.where(seen, np.linspace(0.05, 0.4, N_THETA)[:, None], 0.0)
    median = float(np.median(wild[seen]))
    found = outline(wild, seen)
    assert (found >= 0.5 * median).all() and (found <= 2.0 * median).all()

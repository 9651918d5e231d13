"""Outlines are the surface, and tell what was seen."""

import numpy as np

from tests.report.plots.drawn import half_seen, lines
from ttus_opt.report import plots


def test_outline_is_the_surface_and_tells_seen_from_filled():
    surface = half_seen()
    figure = plots.surface_picture(surface)
    section = next(a for a in figure.axes if a.get_title(loc="left")[:4] == "z = ")
    drawn = lines(section)
    z = float(np.quantile(surface.z, 0.2))
    for label in ("skin, seen", "skin, filled"):
        x, y = drawn[label]
        shown = np.isfinite(x)
        assert shown.any() and not shown.all()
        theta = np.arctan2(y[shown], x[shown])
        r = 100.0 * surface.radius_at(theta % (2 * np.pi), np.full(shown.sum(), z))
        np.testing.assert_allclose(np.hypot(x[shown], y[shown]), r, rtol=1e-3)
    assert drawn["skin, seen"][1][np.isfinite(drawn["skin, seen"][1])].max() > 5
    assert drawn["skin, filled"][1][np.isfinite(drawn["skin, filled"][1])].max() < 0

"""The picture of uncertainty over the skin."""

import numpy as np

from tests.conftest import presses, torso
from ttus_opt.report import plots
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap


def test_it_shows_the_map_in_percent_and_the_recordings():
    theta, z = np.arange(6) * np.pi / 3.0, np.linspace(0.02, 0.18, 4)
    relative = np.linspace(0.1, 0.9, 24).reshape(6, 4)
    told = presses(torso(), 9, np.random.default_rng(0))
    figure = plots.uncertainty_picture(UncertaintyMap(theta, z, relative), told)
    axes = figure.axes[0]
    values = axes.collections[0].get_array()
    assert float(values.min()) == 10.0 and float(values.max()) == 90.0
    (dots,) = axes.lines
    x, y = told.position[:, 0], told.position[:, 1]
    angle = np.radians(dots.get_xdata())
    np.testing.assert_allclose(np.cos(angle), x / np.hypot(x, y))
    np.testing.assert_allclose(dots.get_ydata(), 100.0 * told.position[:, 2])

"""Uncertainty over the skin, and against errors."""

import numpy as np

from tests.kit import InputError, presses, refuses, torso
from tests.report.plots.drawn import lines
from ttus_opt.report import plots
from ttus_opt.report.calibration_curve import CalibrationCurve
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


def test_curves_are_drawn_beside_the_diagonal():
    rng = np.random.default_rng(1)
    std = rng.uniform(0.1, 1.0, (80, 3))
    curves = {
        name: CalibrationCurve.of((wider * std * rng.standard_normal((80, 3)), std))
        for name, wider in (("press", 1.0), ("sweep", 3.0))
    }
    left, right = plots.calibration_picture(curves).axes
    drawn = lines(left)
    for name, curve in curves.items():
        label = f"{name}: {100 * curve.coverage:.0f} %"
        x, y = drawn[label]
        np.testing.assert_allclose(x, 100.0 * curve.level)
        np.testing.assert_allclose(y, 100.0 * curve.force)
        pairs = [(line.get_xdata(), line.get_ydata()) for line in right.lines]
        assert any(
            np.array_equal(a, curve.stated_N) and np.array_equal(b, curve.error_N)
            for a, b in pairs
        )
    for axes in (left, right):
        assert any(
            np.array_equal(line.get_xdata(), line.get_ydata()) for line in axes.lines
        )


def test_without_a_curve_there_is_nothing_to_draw():
    refuses(InputError, "nothing to draw", plots.calibration_picture, {})


def test_no_error_at_all_can_be_drawn(tmp_path):
    none = CalibrationCurve.of((np.zeros((10, 3)), np.zeros((10, 3))))
    figure = plots.calibration_picture({"still": none})
    plots.save_picture(figure, tmp_path / "still.png")
    assert (tmp_path / "still.png").stat().st_size > 0

"""The drawn lines are the curves, and the diagonal is there to compare with."""

import numpy as np

from tests.refusals import refuses
from tests.report.plots.drawn import lines
from ttus_opt.core.errors import InputError
from ttus_opt.report import plots
from ttus_opt.report.calibration_curve import CalibrationCurve


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

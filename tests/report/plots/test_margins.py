"""What stands in the margins of every picture fits into them."""

import numpy as np
import pytest

from tests.report.plots.drawn import half_seen
from ttus_opt.report import plots
from ttus_opt.report.plots.canvas import look


@pytest.mark.parametrize(
    "draw",
    [
        lambda fields, series: plots.force_over_time(series, "presses"),
        lambda fields, series: plots.residual_histogram(
            *([e] for e in series.values())
        ),
        lambda fields, series: plots.overview(fields[1], np.zeros((1, 3)), series),
        lambda fields, series: plots.surface_picture(half_seen()),
        pytest.param(
            lambda fields, series: plots.potential_slices(*fields),
            marks=pytest.mark.slow,
        ),
    ],
    ids=["forces", "residuals", "overview", "surface", "potential"],
)
def test_margins_hold_what_stands_in_them(draw, fields, evaluations):
    figure = draw(fields, evaluations)
    with look():  # ticks are made when they are drawn
        drawn = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    assert drawn.x0 >= 0.0 and drawn.y0 >= 0.0
    assert drawn.x1 <= width and drawn.y1 <= height

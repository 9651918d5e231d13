"""Residuals are counted in full."""

import numpy as np

from ttus_opt.report import plots


def test_residuals_are_counted_in_full(evaluations):
    before, after = evaluations.values()
    figure = plots.residual_histogram([before], [after])
    left, right = figure.axes
    assert "[N]" in left.get_xlabel() and "[mN m]" in right.get_xlabel()
    rms = np.sqrt(((after.rendered_force - after.measured_force) ** 2).mean())
    texts = [text.get_text() for text in left.get_legend().get_texts()]
    assert texts[1] == f"fitted: rms {rms:.2f} N"

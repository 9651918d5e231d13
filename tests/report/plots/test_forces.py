"""Lines are the series that were given, and residuals are counted in full."""

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, ellipsoid, presses, refuses, torso
from tests.report.plots.drawn import lines
from ttus_opt.report import plots


def test_force_lines_are_the_series(evaluations):
    figure = plots.force_over_time(evaluations, "presses")
    magnitude, *components = figure.axes
    drawn = lines(magnitude)
    assert list(drawn) == ["measured", "Laplace alone", "fitted"]
    fitted = evaluations["fitted"]
    np.testing.assert_allclose(
        drawn["fitted"][1], np.linalg.norm(fitted.rendered_force, axis=1)
    )
    for i, axes in enumerate(components):
        np.testing.assert_array_equal(
            lines(axes)["measured"][1], fitted.measured_force[:, i]
        )
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert all(label.endswith("[N]") for label in labels)
    assert components[-1].get_xlabel() == "time [s]"


def test_recordings_stand_one_after_the_other_with_a_gap(fields):
    shell = ellipsoid()
    one = presses(torso(), 10, np.random.default_rng(0))
    both = tt.evaluate(fields[0], shell, tt.Trajectory.concatenate([one, one]))
    clock, values = lines(plots.force_over_time({"rendered": both}).axes[0])["rendered"]
    (gap,) = np.flatnonzero(np.isnan(values))
    assert gap == 10
    assert (np.diff(clock[np.isfinite(clock)]) > 0).all()
    np.testing.assert_allclose(values[:10], values[11:])


def test_force_of_different_trajectories_is_refused(evaluations, fields):
    shell = ellipsoid()
    other = tt.evaluate(fields[0], shell, presses(torso(), 9, np.random.default_rng(1)))
    with pytest.raises(InputError, match="different trajectories"):
        plots.force_over_time({"a": evaluations["fitted"], "b": other})
    refuses(InputError, "one or two", plots.force_over_time, {})


def test_residuals_are_counted_in_full(evaluations):
    before, after = evaluations.values()
    figure = plots.residual_histogram([before], [after])
    left, right = figure.axes
    assert "[N]" in left.get_xlabel() and "[mN m]" in right.get_xlabel()
    rms = np.sqrt(((after.rendered_force - after.measured_force) ** 2).mean())
    texts = [text.get_text() for text in left.get_legend().get_texts()]
    assert texts[1] == f"fitted: rms {rms:.2f} N"

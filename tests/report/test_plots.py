"""Pictures: what is drawn is what was given, and the files are small and whole."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from matplotlib.figure import Figure

from tests.conftest import ellipsoid, presses, torso
from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report import plots
from ttus_opt.report.metrics import Evaluation, evaluate
from ttus_opt.report.plots.canvas import look
from ttus_opt.report.plots.potential import colour_limit, local_change, round_up
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap


def half_seen() -> Surface:
    full = torso()
    observed = np.broadcast_to(
        (np.sin(full.theta) > -0.2)[:, None], full.radius.shape
    ).copy()
    return Surface(
        full.theta, full.z, full.radius, full.radius_std, observed, full.axis
    )


@pytest.fixture(scope="module")
def fields() -> tuple[PotentialField, PotentialField]:
    """A field that falls off with the radius, and one with a dent under the skin."""
    voxmap = Voxmap.from_surface(half_seen(), shape=(24, 40, 12))
    grid = voxmap.grid
    r, theta, z = np.meshgrid(grid.r, grid.theta, grid.z, indexing="ij")
    values = 5.0 * (voxmap.surface.radius_at(theta, z) - r) / 0.08
    near = (r - 0.08) ** 2 + (0.08 * (theta - np.pi / 2)) ** 2 + (z - grid.z[4]) ** 2
    dent = 0.4 * np.exp(-near / 0.01**2)
    before = PotentialField(voxmap, values, "trilinear")
    return before, PotentialField(voxmap, values - dent, "trilinear")


@pytest.fixture(scope="module")
def evaluations(fields: tuple[PotentialField, PotentialField]) -> dict[str, Evaluation]:
    shell = ellipsoid()
    recorded = presses(torso(), 25, np.random.default_rng(0))
    names = ("Laplace alone", "fitted")
    return {n: evaluate(f, shell, recorded) for n, f in zip(names, fields, strict=True)}


def lines(axes: Any) -> dict[str, tuple[Array, Array]]:
    return {
        str(line.get_label()): (
            np.asarray(line.get_xdata(), float),
            np.asarray(line.get_ydata(), float),
        )
        for line in axes.lines
    }


def test_force_lines_are_the_series(evaluations: dict[str, Evaluation]) -> None:
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


def test_recordings_stand_one_after_the_other_with_a_gap(
    fields: tuple[PotentialField, PotentialField],
) -> None:
    shell = ellipsoid()
    one = presses(torso(), 10, np.random.default_rng(0))
    both = evaluate(fields[0], shell, Trajectory.concatenate([one, one]))
    clock, values = lines(plots.force_over_time({"rendered": both}).axes[0])["rendered"]
    (gap,) = np.flatnonzero(np.isnan(values))
    assert gap == 10
    assert (np.diff(clock[np.isfinite(clock)]) > 0).all()
    np.testing.assert_allclose(values[:10], values[11:])


def test_force_of_different_trajectories_is_refused(
    evaluations: dict[str, Evaluation],
    fields: tuple[PotentialField, PotentialField],
) -> None:
    shell = ellipsoid()
    other = evaluate(fields[0], shell, presses(torso(), 9, np.random.default_rng(1)))
    with pytest.raises(InputError, match="different trajectories"):
        plots.force_over_time({"a": evaluations["fitted"], "b": other})
    with pytest.raises(InputError, match="one or two"):
        plots.force_over_time({})


@pytest.mark.slow
def test_potential_shows_the_slice_that_changed_most(
    fields: tuple[PotentialField, PotentialField],
) -> None:
    figure = plots.potential_slices(*fields)
    z = fields[0].voxmap.grid.z[4]
    assert figure.get_suptitle().startswith(f"Potential at z = {100 * z:.1f} cm")
    bars = [a.get_xlabel() for a in figure.axes if "p [" in a.get_xlabel()]
    assert bars == ["p [N/cm²]", "p [N/cm²]", "Δp [N/cm²]"]
    # the enlarged part is centred where the dent is: on +y, 8 cm from the axis
    part = figure.axes[5]
    assert np.mean(part.get_xlim()) == pytest.approx(0.0, abs=0.7)
    assert np.mean(part.get_ylim()) == pytest.approx(8.0, abs=0.7)


def test_what_another_boundary_value_changes_everywhere_is_left_out(
    fields: tuple[PotentialField, PotentialField],
) -> None:
    before, after = fields
    scaled = PotentialField(after.voxmap, 1.5 * after.values, after.sampling)
    dent = np.argmax(local_change(before, scaled))
    assert dent == np.argmax(np.abs(after.values - before.values))
    inside = before.voxmap.inside
    assert not local_change(before, scaled)[~inside].any()


def _data(line: Any) -> tuple[Array, Array]:
    return line.get_xdata(), line.get_ydata()


def test_one_field_in_one_slice(
    fields: tuple[PotentialField, PotentialField],
) -> None:
    grid = fields[0].voxmap.grid
    figure = plots.field_slice(fields[0], z=grid.z[7])
    axes, bar = figure.axes
    assert axes.get_title(loc="left") == f"Potential at z = {100 * grid.z[7]:.1f} cm"
    assert bar.get_ylabel() == "p [N/cm²]"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [cm]", "y [cm]")
    x, y = (
        np.concatenate(parts) for parts in zip(*map(_data, axes.lines), strict=True)
    )
    skin = fields[0].voxmap.surface.radius_at(np.array(0.0), np.array(grid.z[7]))
    assert np.nanmax(np.hypot(x, y)) == pytest.approx(100 * float(skin), rel=0.05)
    with pytest.raises(InputError, match="in metres"):
        plots.field_slice(fields[0], z=10.0)


def test_colours_are_centred_at_zero(
    fields: tuple[PotentialField, PotentialField],
) -> None:
    figure = plots.potential_slices(*fields)
    for axes in figure.axes[:6]:
        filled = axes.collections[0]
        assert filled.norm.vmin == pytest.approx(-filled.norm.vmax)
    assert 0.5 < colour_limit(fields[0], 4) < 5.0


def test_fields_on_two_grids_are_refused(
    fields: tuple[PotentialField, PotentialField],
) -> None:
    voxmap = Voxmap.from_surface(torso(), shape=(20, 40, 12))
    other = PotentialField(voxmap, np.zeros((20, 40, 12)), "trilinear")
    with pytest.raises(InputError, match="one grid"):
        plots.potential_slices(fields[0], other)


@pytest.mark.parametrize(
    ("value", "up"), [(0.0, 1.0), (0.16, 0.2), (2.0, 2.0), (9.4, 10.0), (73.0, 80.0)]
)
def test_scales_end_at_a_round_number(value: float, up: float) -> None:
    assert round_up(value) == pytest.approx(up)


def test_outline_is_the_surface_and_tells_seen_from_filled() -> None:
    surface = half_seen()
    figure = plots.surface_picture(surface)
    section = next(a for a in figure.axes if a.get_title(loc="left")[:4] == "z = ")
    drawn = lines(section)
    z = float(np.quantile(surface.z, 0.2))
    for label in ("surface, seen", "filled"):
        x, y = drawn[label]
        shown = np.isfinite(x)
        assert shown.any() and not shown.all()
        theta = np.arctan2(y[shown], x[shown])
        r = 100.0 * surface.radius_at(theta % (2 * np.pi), np.full(shown.sum(), z))
        np.testing.assert_allclose(np.hypot(x[shown], y[shown]), r, rtol=1e-3)
    assert drawn["surface, seen"][1][np.isfinite(drawn["surface, seen"][1])].max() > 5
    assert drawn["filled"][1][np.isfinite(drawn["filled"][1])].max() < 0


def test_residuals_are_counted_in_full(evaluations: dict[str, Evaluation]) -> None:
    before, after = evaluations.values()
    figure = plots.residual_histogram([before], [after])
    left, right = figure.axes
    assert "[N]" in left.get_xlabel() and "[mN m]" in right.get_xlabel()
    rms = np.sqrt(((after.rendered_force - after.measured_force) ** 2).mean())
    texts = [text.get_text() for text in left.get_legend().get_texts()]
    assert texts[1] == f"fitted: rms {rms:.2f} N"


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
def test_margins_hold_what_stands_in_them(
    draw: Callable[..., Figure],
    fields: tuple[PotentialField, PotentialField],
    evaluations: dict[str, Evaluation],
) -> None:
    figure = draw(fields, evaluations)
    with look():  # ticks are made when they are drawn
        drawn = figure.get_tightbbox()
    width, height = figure.get_size_inches()
    assert drawn.x0 >= 0.0 and drawn.y0 >= 0.0
    assert drawn.x1 <= width and drawn.y1 <= height

"""Slices show what changed, on scales that end at round numbers."""

from dataclasses import replace

import numpy as np
import pytest
from matplotlib import colormaps

import ttus_opt as tt
from tests.kit import InputError, refuses, torso
from ttus_opt.report.plots import potential
from ttus_opt.report.plots.canvas import COLOURS


@pytest.mark.slow
@pytest.mark.parametrize("scale", [1.0, 1.5])
def test_potential_shows_the_slice_that_changed_most(fields, scale):
    """What another boundary value changes everywhere is left out."""
    before, after = fields
    scaled = replace(after, values=scale * after.values)
    figure = tt.plots.potential_slices(before, scaled)
    z = fields[0].voxmap.grid.z[4]
    assert figure.get_suptitle().startswith(f"Potential at z = {100 * z:.1f} cm")
    bars = [a.get_xlabel() for a in figure.axes if "p [" in a.get_xlabel()]
    assert bars == ["p [N/cm²]", "p [N/cm²]", "Δp [N/cm²]"]
    # the enlarged part is centred where the dent is: on +y, 8 cm from the axis
    part = figure.axes[5]
    assert np.mean(part.get_xlim()) == pytest.approx(0.0, abs=0.7)
    assert np.mean(part.get_ylim()) == pytest.approx(8.0, abs=0.7)


def test_the_scale_s_change_is_left_out_of_the_difference_and_greys_rise(fields):
    before, after = fields
    assert potential.common_factor(before, before) == pytest.approx(1.0)
    scaled = replace(after, values=3.0 * after.values)
    assert potential.common_factor(before, scaled) == pytest.approx(
        3.0 * potential.common_factor(before, after)
    )
    grey = colormaps[COLOURS](np.linspace(0, 1, 50))[:, :3] @ [0.299, 0.587, 0.114]
    assert (np.diff(grey) > 0).all()


def _data(line):
    return line.get_xdata(), line.get_ydata()


def test_one_field_in_one_slice(fields):
    grid = fields[0].voxmap.grid
    figure = tt.plots.field_slice(fields[0], z=grid.z[7])
    axes, bar = figure.axes
    assert axes.get_title(loc="left") == f"Potential at z = {100 * grid.z[7]:.1f} cm"
    assert bar.get_ylabel() == "p [N/cm²]"
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [cm]", "y [cm]")
    x, y = (
        np.concatenate(parts) for parts in zip(*map(_data, axes.lines), strict=True)
    )
    skin = fields[0].voxmap.surface.radius_at(np.array(0.0), np.array(grid.z[7]))
    assert np.nanmax(np.hypot(x, y)) == pytest.approx(100 * float(skin), rel=0.05)
    refuses(InputError, "in metres", tt.plots.field_slice, fields[0], z=10.0)


def test_colours_are_centred_at_zero(fields):
    figure = tt.plots.potential_slices(*fields)
    for axes in figure.axes[:6]:
        filled = axes.collections[0]
        assert filled.norm.vmin == pytest.approx(-filled.norm.vmax)
    assert 0.5 < potential.colour_limit(fields[0], 4) < 5.0


def test_fields_on_two_grids_are_refused(fields):
    voxmap = tt.Voxmap.from_surface(torso(), shape=(20, 40, 12))
    other = tt.PotentialField(voxmap, np.zeros((20, 40, 12)), "trilinear")
    refuses(InputError, "one grid", tt.plots.potential_slices, fields[0], other)


@pytest.mark.parametrize(
    ("value", "up"), [(0.0, 1.0), (0.16, 0.2), (2.0, 2.0), (9.4, 10.0), (73.0, 80.0)]
)
def test_scales_end_at_a_round_number(value, up):
    assert potential.round_up(value) == pytest.approx(up)

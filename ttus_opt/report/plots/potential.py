"""The potential in a transverse slice: one field, or before, after and difference."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.report.plots.canvas import COLOURS, add_axes, look, new_figure
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField

#: Units of the potential, as of the file
UNITS = {"N": "N", "N cm-2": "N/cm²"}

#: The colour scale covers values within this distance of the skin [m]
_SKIN_DEPTH = 0.025

#: Half the width of the enlarged part [m]
_WINDOW = 0.04


def potential_slices(
    before: PotentialField, after: PotentialField, z: float | None = None
) -> Figure:
    """Two fields and their difference in one slice.

    Args:
        before: For instance the Laplace field alone.
        after: The field fitted to measurements, on the same grid.
        z: Height of the slice [m]; by default where the fields differ most just below
            the skin.

    Returns:
        A figure with the slice above and, enlarged below, the part where the fields
        differ most. Contours are solid for p > 0 and dashed for p < 0. The difference
        is that from a multiple of the first field (`common_factor`): another boundary
        value alone would fill it.

    Raises:
        InputError: The fields have different grids.
    """
    grid = before.voxmap.grid
    if grid != after.voxmap.grid:
        raise InputError("both fields must be on one grid: fit them on one voxmap")
    factor, below = common_factor(before, after), _below_skin(before)
    change = after.values - factor * before.values
    local = np.where(below, np.abs(change), 0.0)
    if z is None:
        k = int(np.argmax(local.max(axis=(0, 1))))
    else:
        k = int(np.argmin(np.abs(grid.z - z)))
    panels = {
        "Laplace prior alone": before.values[:, :, k],
        "fitted to measured wrenches": after.values[:, :, k],
        f"fitted − {factor:.2f} × prior": change[:, :, k],
    }
    i, j = np.unravel_index(np.argmax(local[:, :, k]), local.shape[:2])
    spot = 100.0 * grid.r[i] * np.array([np.cos(grid.theta[j]), np.sin(grid.theta[j])])
    common = colour_limit(before, k)
    most = round_up(float(local[:, :, k].max()))
    with look():
        figure = new_figure(9.6, 6.6, margins=(0.69, 0.35, 1.26, 0.46))
        axes = figure.subplots(2, 3, gridspec_kw={"wspace": 0.374, "hspace": 0.131})
        for column, (title, values) in enumerate(panels.items()):
            is_change = title.startswith("fitted −")
            limit = most if is_change else common
            for ax in axes[:, column]:
                mesh = draw_slice(ax, after, values, k, limit)
            axes[0, column].set_title(title)
            _enlarge(axes[0, column], axes[1, column], spot)
            left, width = axes[1, column].get_position().bounds[::2]
            place = add_axes(
                figure, (9.6 * left - 0.18, 0.42, 9.6 * width + 0.36, 0.14)
            )
            bar = figure.colorbar(mesh, cax=place, orientation="horizontal")
            bar.set_label(f"{'Δ' * is_change}p [{UNITS[after.unit]}]")
            bar.set_ticks([share * limit for share in (-1.0, -0.5, 0.0, 0.5, 1.0)])
        for ax in axes[:, 0]:
            ax.set_ylabel("y [cm]")
        figure.suptitle(
            f"Potential at z = {100 * grid.z[k]:.1f} cm; below: the marked part",
            x=0.01,
            y=0.995,
            ha="left",
            fontsize=10,
        )
        figure.legend(*_skin_lines(axes[0, 0]), loc="upper right", ncols=2)
    return figure


def field_slice(field: PotentialField, z: float | None = None) -> Figure:
    """One field in one transverse slice.

    Args:
        field: The field.
        z: Height; the nearest slice is drawn [m]. By default the middle of the grid.

    Returns:
        A figure of p. Contours are solid for p > 0 and dashed for p < 0; the skin is
        solid where it was seen and dotted where it was filled.

    Raises:
        InputError: The height is outside the grid.
    """
    grid = field.voxmap.grid
    wanted = (grid.z_min + grid.z_max) / 2 if z is None else z
    if not grid.z_min <= wanted <= grid.z_max:
        raise InputError(
            f"z must lie on the grid, {grid.z_min:.4g} to {grid.z_max:.4g} m, got "
            f"{wanted:.4g}: is it in metres?"
        )
    k = int(np.argmin(np.abs(grid.z - wanted)))
    limit = colour_limit(field, k)
    with look():
        figure = new_figure(4.8, 4.0)
        axes = figure.subplots()
        mesh = draw_slice(axes, field, field.values[:, :, k], k, limit)
        axes.set_title(f"Potential at z = {100 * grid.z[k]:.1f} cm")
        axes.set(xlabel="x [cm]", ylabel="y [cm]")
        bar = figure.colorbar(mesh, ax=axes)
        bar.set_label(f"p [{UNITS[field.unit]}]")
        bar.set_ticks([share * limit for share in (-1.0, -0.5, 0.0, 0.5, 1.0)])
        figure.legend(*_skin_lines(axes), loc="outside lower center", ncols=2)
    return figure


def _skin_lines(axes: Any) -> tuple[list[Any], list[str]]:
    """The two lines of the skin, and their labels."""
    handles, labels = axes.get_legend_handles_labels()
    return handles[:2], labels[:2]


def colour_limit(field: PotentialField, k: int) -> float:
    """Limit of the colours in slice k: the 90th percentile of |p| near the skin."""
    near = np.abs(field.values[:, :, k][_near_skin(field)[:, :, k]])
    return round_up(float(np.percentile(near, 90)))


def _near_skin(field: PotentialField) -> Mask:
    """Voxels near the skin, shape ``grid.shape``."""
    grid = field.voxmap.grid
    near = np.abs(grid.r[:, None, None] - field.voxmap.spoke_radius) < _SKIN_DEPTH
    return np.asarray(near & grid.in_sector(grid.theta)[:, None])


def _below_skin(field: PotentialField) -> Mask:
    """Those of them inside the body."""
    return np.asarray(_near_skin(field) & field.voxmap.inside)


def common_factor(before: PotentialField, after: PotentialField) -> float:
    """The multiple of one field that is nearest to another just below the skin [–]."""
    near = _below_skin(before)
    old, new = before.values[near], after.values[near]
    return float(old @ new / (old @ old)) if old.any() else 1.0


def round_up(value: float) -> float:
    """Round up to one significant digit, for scales; 1 for zero.

    >>> round_up(7.43), round_up(0.16)
    (8.0, 0.2)
    """
    if value <= 0.0:
        return 1.0
    unit = 10.0 ** math.floor(math.log10(value))
    return float(f"{math.ceil(value / unit) * unit:.1g}")


def _enlarge(whole: Any, part: Any, spot: Array) -> None:
    """Show the surroundings of a spot [cm] in ``part`` and mark them in ``whole``."""
    half = 100.0 * _WINDOW
    low, edge = spot - half, 2.0 * half
    part.set_xlim(low[0], low[0] + edge)
    part.set_ylim(low[1], low[1] + edge)
    part.set_xlabel("x [cm]")
    whole.add_patch(Rectangle(tuple(low), edge, edge, fill=False, linewidth=0.8))


def draw_slice(
    axes: Any, field: PotentialField, values: Array, k: int, limit: float
) -> Any:
    """Draw values of one slice into given axes.

    Args:
        axes: The axes to draw into.
        field: Field with the grid and the surface.
        values: Values, shape (n_r, n_theta).
        k: Number of the slice.
        limit: The colours range from -limit to limit.

    Returns:
        The mappable for a colour bar.
    """
    grid = field.voxmap.grid
    theta = np.append(grid.theta, 2.0 * np.pi)
    closed = np.concatenate([values, values[:, :1]], axis=1)
    if grid.sector is not None:  # extend constant values up to the sector's sides
        closed = np.pad(values[:, :-1], ((0, 0), (1, 1)), mode="edge")
        theta = np.concatenate([grid.sector[:1], grid.theta[:-1], grid.sector[1:]])
    x = 100.0 * grid.r[:, None] * np.cos(theta)
    y = 100.0 * grid.r[:, None] * np.sin(theta)
    bands = limit * np.linspace(-1.0, 1.0, 21)
    mesh = axes.contourf(x, y, closed, bands, cmap=COLOURS, extend="both")
    lines = np.delete(bands[::2], 5)  # without zero: only rounding decides there
    style = ["dashed" if level < 0 else "solid" for level in lines]
    inks = ["0.9" if level < 0 else "0.15" for level in lines]  # on dark, on light
    axes.contour(x, y, closed, lines, colors=inks, linewidths=0.6, linestyles=style)
    draw_outline(axes, field.voxmap.surface, float(grid.z[k]))
    axes.set_aspect("equal")
    return mesh


def draw_outline(axes: Any, surface: Surface, z: float) -> None:
    """Draw the skin at a height [m]: solid where it was seen, dotted where filled."""
    k = int(np.argmin(np.abs(surface.z - z)))
    theta = np.append(surface.theta, surface.theta[0] + 2.0 * np.pi)
    radius = surface.radius_at(theta, np.full(len(theta), z))
    seen = np.append(surface.observed[:, k], surface.observed[0, k])
    x, y = 100.0 * radius * np.cos(theta), 100.0 * radius * np.sin(theta)
    # a line segment is seen if both its ends are
    both = seen & np.roll(seen, -1)
    keep_seen = both | np.roll(both, 1)
    keep_filled = ~both | np.roll(~both, 1)
    for keep, line, width, label in (
        (keep_seen, "-", 1.5, "skin, seen"),
        (keep_filled, (0, (1, 1.5)), 1.3, "skin, filled"),
    ):
        at = np.where(keep, x, np.nan), np.where(keep, y, np.nan)
        (drawn,) = axes.plot(*at, color="black", linestyle=line, label=label)
        drawn.set_linewidth(width)

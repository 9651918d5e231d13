"""The surface and its observed part: in space, unrolled, and in a few slices."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection

from ttus_opt.core.arrays import Array
from ttus_opt.report.plots.canvas import SHADES, add_axes, look, new_figure, unroll
from ttus_opt.report.plots.potential import draw_outline
from ttus_opt.scan.surface import Surface


def surface_picture(surface: Surface, cloud: Array | None = None) -> Figure:
    """Draw a surface.

    Args:
        surface: The surface.
        cloud: Its scan, scan frame, shape (n, 3) [m].

    Returns:
        A figure with the surface in space (top left), the unrolled surface with its
        unseen part hatched (top right), and three slices with the scan's points below.
    """
    points = None if cloud is None else surface.axis.to_patient(cloud)
    with look():
        figure = new_figure(9.0, 7.0, margins=(0.81, 0.28, 0.76, 4.0))
        space = add_axes(figure, (0.26, 3.33, 3.43, 3.43), projection="3d")
        _draw_in_space(space, surface)
        unrolled = add_axes(figure, (4.53, 3.75, 3.4, 3.01))
        _draw_unrolled(unrolled, add_axes(figure, (8.2, 3.75, 0.15, 3.01)), surface)
        heights = np.quantile(surface.z, (0.2, 0.5, 0.8))
        columns = {"wspace": 0.263}
        axes = figure.subplots(1, 3, sharex=True, sharey=True, gridspec_kw=columns)
        for ax, z in zip(axes, heights, strict=True):
            draw_section(ax, surface, float(z), points)
            ax.set_title(f"z = {100 * z:.1f} cm")
            ax.set_xlabel("x [cm]")
        axes[0].set_ylabel("y [cm]")
        handles, labels = axes[-1].get_legend_handles_labels()
        figure.legend(handles, labels, loc="lower center", ncols=4, borderaxespad=0.1)
    return figure


def draw_section(axes: Any, surface: Surface, z: float, points: Array | None) -> None:
    """Draw one slice of the surface and the scan points near it.

    Args:
        axes: The axes to draw into.
        surface: The surface.
        z: Height of the slice [m].
        points: The scan, patient frame, shape (n, 3) [m], if any.
    """
    reach = 100.0 * (float(surface.radius.max()) + 0.03)
    if points is not None:
        near = np.abs(points[:, 2] - z) < 0.004
        x, y = 100.0 * points[near, 0], 100.0 * points[near, 1]
        shown = (np.abs(x) < reach) & (np.abs(y) < reach)
        axes.plot(
            x[shown],
            y[shown],
            linestyle="none",
            marker="o",
            markersize=2.6,
            markerfacecolor="none",
            markeredgecolor="0.45",
            markeredgewidth=0.5,
            label="scan within 4 mm",
        )
    draw_outline(axes, surface, z)
    axes.plot(0.0, 0.0, "+", color="0.3", markersize=6, label="z axis")
    axes.set_aspect("equal")
    axes.set_xlim(-reach, reach)
    axes.set_ylim(-reach, reach)


def _draw_unrolled(axes: Any, bar: Any, surface: Surface) -> None:
    nodes, radius = (
        (np.degrees(surface.theta), 100.0 * surface.z),
        100.0 * surface.radius,
    )
    drawn = {"cmap": SHADES, "shading": "nearest", "rasterized": True}
    mesh = axes.pcolormesh(*nodes, radius.T, **drawn)
    unseen = (~surface.observed.T).astype(float)
    if unseen.any():
        hatched = {"colors": "none", "hatches": ["////"]}
        axes.contourf(*nodes, unseen, levels=[0.5, 1.5], **hatched)
    axes.figure.colorbar(mesh, cax=bar, label="radius R [cm]")
    share = 100.0 * surface.observed.mean()
    axes.set_title(f"unrolled: {share:.0f} % observed, hatched = filled")
    unroll(axes)
    axes.set_ylabel("z [cm]")


def _draw_in_space(axes: Any, surface: Surface) -> None:
    """Draw the skin with the body's axis to the right and its seen side up."""
    nodes = surface.points()
    closed = 100.0 * np.concatenate([nodes, nodes[:1]])
    seen = np.concatenate([surface.observed, surface.observed[:1]])[:-1, :-1]
    along, up = np.array([0.0, 0.0, 1.0]), surface.front
    placed = closed @ np.stack([along, np.cross(up, along), up]).T
    x, y, z = np.moveaxis(placed, -1, 0)
    normal = np.cross(
        placed[1:, :-1] - placed[:-1, :-1], placed[:-1, 1:] - placed[:-1, :-1]
    )
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    elevation, azimuth = 35.0, -60.0
    e, a = np.radians([elevation, azimuth])
    eye = np.array([np.cos(e) * np.cos(a), np.cos(e) * np.sin(a), np.sin(e)])
    light = np.array([0.25, -0.65, 0.72])
    bright = 0.45 + 0.55 * np.clip(normal @ light, 0.0, 1.0)
    # seen skin is dark, filled skin light, and the inner side of the skin darkest
    shade = np.where(seen[..., None], [0.80, 0.58, 0.40], [0.93, 0.93, 0.93])
    shade = np.where((normal @ eye < 0)[..., None], [0.35, 0.35, 0.35], shade)
    # faster than plot_surface, which loops over the patches in Python
    corners = [placed[:-1, :-1], placed[:-1, 1:], placed[1:, 1:], placed[1:, :-1]]
    skin = Poly3DCollection(
        np.stack(corners, axis=2).reshape(-1, 4, 3),
        facecolors=np.clip(shade * bright[..., None], 0.0, 1.0).reshape(-1, 3),
        edgecolors="none",
        antialiased=False,
        rasterized=True,
    )
    axes.add_collection3d(skin, autolim=False)
    axes.auto_scale_xyz(x, y, z)
    axes.set_box_aspect([float(np.ptp(c)) for c in (x, y, z)], zoom=1.15)
    axes.view_init(elev=elevation, azim=azimuth)
    axes.set_axis_off()
    axes.set_title("tinted = seen, white = filled")

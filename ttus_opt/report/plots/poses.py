"""The probe's poses on the skin with measured forces as arrows, one row per recording.

Three projections show the patient lying on the back: from above, from the side and
along the body. A recording with wrong columns, frame or sign appears away from the
skin, or its arrows point the wrong way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.extrapolation import Contacts
from ttus_opt.report.metrics import FORCE_THRESHOLD
from ttus_opt.report.plots.canvas import look, new_figure
from ttus_opt.report.plots.potential import round_up
from ttus_opt.scan.surface import Surface

#: Largest number of recordings, and of arrows and probe outlines in each
RECORDINGS, ARROWS, PROBES = 8, 60, 3

#: Length of an arrow of the largest force [cm], and how arrows are drawn
LONGEST = 6.0
ARROW = dict(angles="xy", scale_units="xy", scale=1.0, width=3e-3, headwidth=4.5)

#: Label, colour and marker by contact of the geometry and contact by force
_KINDS: dict[tuple[bool, bool], tuple[str, str, str]] = {
    (True, True): ("contact and force", "#0b4f9c", "o"),
    (True, False): ("contact, no force", "#e08214", "s"),
    (False, True): ("force, no contact", "#b2182b", "X"),
    (False, False): ("neither", "0.6", "."),
}


class _View(NamedTuple):
    """A projection: its name, and the directions to the right and upwards."""

    name: str
    right: Array
    up: Array


def pose_picture(
    surface: Surface,
    shell: PointShell,
    trajectory: Trajectory,
    names: Sequence[str] = (),
) -> Figure:
    """Draw the probe's poses and the measured forces.

    Args:
        surface: The patient's surface.
        shell: The probe.
        trajectory: One or several recordings, in the patient frame.
        names: Names of the recordings (segments); numbers by default.

    Returns:
        A figure with a row for each of the first `RECORDINGS` recordings. The colour of
        a frame shows whether the probe's geometry touches the skin and whether a force
        was measured; the force's arrow starts at the probe's reference point.

    Raises:
        InputError: The number of names is not the number of recordings.
    """
    recordings = trajectory.recordings
    names = names or [f"recording {own.segment[0]}" for own in recordings]
    if len(names) != len(recordings):
        raise InputError(
            f"{len(recordings)} recordings need as many names, got {len(names)}"
        )
    shown = recordings[:RECORDINGS]
    views = _views(surface)
    largest = 0.0 if trajectory.force is None else np.abs(trajectory.force).max()
    longest = round_up(float(largest))  # [N]
    with look():
        figure = new_figure(11.0, 0.7 + 3.3 * len(shown))
        axes = figure.subplots(
            len(shown), 3, squeeze=False, width_ratios=(1.2, 1.2, 1.0)
        )
        for row, own, name in zip(axes, shown, names, strict=False):
            frames = _Frames.of(surface, shell, own)
            for axis, view in zip(row, views, strict=True):
                _draw_skin(axis, surface, view, float(np.median(frames.at[:, 2])))
                _draw(axis, frames, view, longest)
                axis.set_title(view.name)
            row[0].set_title(f"{name}: {views[0].name}")
        drawn = {
            label: handle
            for axis in axes.flat
            for handle, label in zip(*axis.get_legend_handles_labels(), strict=True)
        }
        figure.legend(drawn.values(), drawn.keys(), loc="outside lower center", ncols=6)
        left = f", first {len(shown)} of {len(recordings)}" * (
            len(recordings) > len(shown)
        )
        figure.suptitle(
            "Probe and measured force in the patient frame, patient on the back, z "
            f"along the body{left}; {LONGEST:.0f} cm of arrow = {longest:g} N",
            x=0.01,
            ha="left",
            fontsize=10,
        )
    return figure


def _views(surface: Surface) -> tuple[_View, _View, _View]:
    """Projections with the axis nearest to the scanned side pointing up."""
    nearest = int(np.argmax(np.abs(surface.front)))
    up, along = np.zeros(3), np.array([0.0, 0.0, 1.0])
    up[nearest] = np.sign(surface.front[nearest])
    across = np.cross(up, along)
    return (
        _View("seen from above", along, across),
        _View("from the side", along, up),
        _View("along the body", across, up),
    )


@dataclass(frozen=True)
class _Frames:
    """The frames of one recording to draw.

    Attributes:
        at: The probe's reference point, patient frame, shape (n, 3) [m].
        force: Measured force, if any, shape (n, 3) [N].
        kinds: Contact by geometry and by force, shape (n, 2).
        probes: Points of the probe in a few frames, patient frame, each (M, 3) [m].
    """

    at: Array
    force: Array | None
    kinds: NDArray[np.bool_]
    probes: list[Array]

    @classmethod
    def of(cls, surface: Surface, shell: PointShell, recorded: Trajectory) -> _Frames:
        """Choose frames of a recording at even intervals."""
        n = len(recorded)
        some = recorded.select(np.unique(np.linspace(0, n - 1, ARROWS).astype(int)))
        contact = Contacts.of(surface, shell, some).depth > 0.0
        felt = np.zeros_like(contact)
        if some.force is not None:
            felt = np.linalg.norm(some.force, axis=1) > FORCE_THRESHOLD
        shown = np.linspace(0, len(some) - 1, PROBES + 2).astype(int)[1:-1]
        return cls(
            some.rotation @ shell.reference + some.position,
            some.force,
            np.stack([contact, felt], axis=1),
            [shell.points @ some.rotation[i].T + some.position[i] for i in shown],
        )


def _draw(axis: Any, frames: _Frames, view: _View, longest: float) -> None:
    """Draw one recording in one projection, in cm."""
    plane = 100.0 * np.stack([view.right, view.up], axis=1)
    for points in frames.probes:
        outline = _outline(points @ plane)
        axis.plot(*outline.T, color="0.2", linewidth=0.7, label="probe")
    for kind, (label, ink, marker) in _KINDS.items():
        alike = (frames.kinds == kind).all(axis=1)
        if not alike.any():
            continue
        at = frames.at[alike] @ plane
        axis.plot(
            *at.T, linestyle="none", marker=marker, color=ink, markersize=3, label=label
        )
        if frames.force is not None:
            along = frames.force[alike] @ plane * (LONGEST / longest / 100.0)
            axis.quiver(*at.T, *along.T, color=ink, **ARROW)
            axis.update_datalim(at + along)
    axis.set_aspect("equal", adjustable="datalim")
    axis.autoscale_view()
    _label(axis, view)


def _label(axis: Any, view: _View) -> None:
    """Label the axes with those of the patient frame and their signs."""
    for set_label, direction in (
        (axis.set_xlabel, view.right),
        (axis.set_ylabel, view.up),
    ):
        number = int(np.argmax(np.abs(direction)))
        sign = "−" if direction[number] < 0 else ""
        set_label(f"{sign}{'xyz'[number]} [cm]")


def _outline(points: Array) -> Array:
    """The closed convex hull of points in the plane, shape (n, 2)."""
    from scipy.spatial import ConvexHull

    # QJ (joggled input), because a flat probe seen edge-on is a line
    corners = ConvexHull(points, qhull_options="QJ").vertices
    return np.asarray(points[np.append(corners, corners[0])])


def _draw_skin(axis: Any, surface: Surface, view: _View, z: float) -> None:
    """Draw the skin's silhouette or, in a view along z, its section at a height."""
    nodes = surface.points()
    if abs(view.right[2]) < 0.5:
        outline = nodes[:, int(np.argmin(np.abs(surface.z - z)))]
        closed = 100.0 * np.stack([outline @ view.right, outline @ view.up], axis=1)
        axis.fill(*closed.T, color="0.92", zorder=0)
        loop = np.vstack([closed, closed[:1]])
        axis.plot(*loop.T, color="black", linewidth=1.2, label="skin")
        return
    reach = 100.0 * nodes @ view.up
    height = 100.0 * surface.z
    low, high = reach.min(axis=0), reach.max(axis=0)
    axis.fill_between(height, low, high, color="0.92", zorder=0)
    for edge in (low, high):
        axis.plot(height, edge, color="black", linewidth=1.2)

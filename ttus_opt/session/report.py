"""Last step of a session: a report in Markdown and HTML, with pictures."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ttus_opt.probe.point_shell import PointShell
from ttus_opt.report.document import Block, Heading, Table, Text, write_report
from ttus_opt.report.tables import error_section
from ttus_opt.session.figures import draw

if TYPE_CHECKING:
    from ttus_opt.session.pipeline import SessionResult


def write_reports(
    result: SessionResult, shell: PointShell, path: Callable[[str], Path]
) -> None:
    """Draw the pictures and write ``report.md`` and ``report.html``.

    Args:
        result: Result of the session.
        shell: The probe.
        path: Function that maps the name of a file to its path.

    Raises:
        FileError: A file cannot be written.
    """
    pictures = draw(result, shell)
    for name in ("report.html", *(picture.path for picture in pictures)):
        path(name)
    blocks = [*summary(result), Heading("Pictures"), *pictures]
    write_report(path("report.md").parent, blocks)


def summary(result: SessionResult) -> list[Block]:
    """The report without its pictures."""
    return [
        Heading(result.session.title, 1),
        Text(
            "From the recording to a field that renders contact forces; every step "
            "with what it found. Made by `ttus-opt session`."
        ),
        Heading("What was found"),
        Table(["step", "found"], _steps(result)),
        *error_section(result.comparisons),
    ]


def _steps(result: SessionResult) -> list[list[str]]:
    rows = [
        ["surface", _surface(result)],
        ["registration", _registration(result)],
        ["clock", _clock(result)],
        ["load", _load(result)],
    ]
    for part in result.session.recordings:
        frames = result.recordings[part.name]
        n = len(set(frames.segment.tolist()))
        use = "fitted" if part.fitted else "judged"
        rows.append(
            [
                part.name,
                f"{len(frames)} frames from {part.start:g} to {part.end:g} s in {n} "
                f"piece{'s' * (n != 1)}, {use}",
            ]
        )
    after = result.model.after
    worst = (
        "" if after.kkt is None else f", KKT residual {after.kkt.worst_relative:.1e}"
    )
    shape = " × ".join(map(str, result.session.fit.shape))
    known = "; ".join(after.identified)
    found_too = f"; {known}" if known else ""
    rows.extend(["fit", line] for line in result.model.choice.lines)
    rows.append(
        ["fit", f"{after.formulation} on {shape} by {after.solver}{worst}{found_too}"]
    )
    return rows


def _surface(result: SessionResult) -> str:
    surface = result.skin.surface
    cloud = result.skin.cloud
    source = "given" if cloud is None else f"from {len(cloud):,} points"
    return (
        f"{source}, {100 * surface.observed.mean():.0f} % of the radii seen, "
        f"{100 * (surface.z[-1] - surface.z[0]):.0f} cm long"
    )


def _registration(result: SessionResult) -> str:
    tags = result.registration.tags
    if tags is None:
        return "motions as given"
    return (
        f"tracker to scan from {tags.pairs} pairs of tag poses ({tags.solver}): loops "
        f"close to {1e3 * tags.loop.gap:.2f} mm and "
        f"{np.rad2deg(tags.loop.twist):.2f}°, solvers differ by "
        f"{1e3 * tags.spread:.2f} mm"
    )


def _clock(result: SessionResult) -> str:
    timing = result.timing
    how = "as given"
    if timing.correlation is not None:
        how = f"by {result.session.clock.by}, correlation {timing.correlation:.3f}"
    left_out = result.figures["clock"]["left_out"]
    return (
        f"forces moved by {timing.offset:.4f} s ({how}); {left_out} poses without "
        "forces left out"
    )


def _load(result: SessionResult) -> str:
    load = result.load
    if load is None:
        return "readings were compensated already"
    centre = ", ".join(f"{1e3 * v:.1f}" for v in load.centre)
    return (
        f"{load.mass:.3f} ± {load.mass_std:.2g} kg, centre ({centre}) mm from the "
        f"sensor's point; free air leaves {load.force_residual:.2g} N and "
        f"{1e3 * load.torque_residual:.2g} mN m"
    )

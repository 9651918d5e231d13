"""``ttus-opt next-press``: where the next presses tell most about the patient."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ttus_opt.cli.console import Stages, fitted, tell
from ttus_opt.cli.options import numbers
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.scene_building import measured
from ttus_opt.cli.scene_options import ProblemOptions, SceneOptions, sector_of

if TYPE_CHECKING:
    from ttus_opt.fitting.uncertainty.next_press import NextPresses


#: What is told of a place
PRESS_COLUMNS = [
    *("", "θ [°]", "z [cm]", "skin x, y, z [cm]", "normal"),
    *("variance [%]", "force [N]", "std [N]"),
]


def next_press(
    surface: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    grid: SceneOptions,
    problem: ProblemOptions,
    count: Annotated[int, typer.Option(min=1)] = 5,
    angles: Annotated[str | None, typer.Option(metavar="FROM,TO")] = None,
    box: Annotated[str | None, typer.Option(metavar="XMIN,XMAX,…,ZMAX")] = None,
    depth: float | None = None,
    spacing: float = 0.02,
    output: Path | None = None,
    picture: Path | None = None,
) -> None:
    """Name the places where the next presses reduce the uncertainty most.

    The recordings are fitted as by ttus-opt fit. Every place of the skin that the scan
    saw is a candidate; the first place explains most of the variance of the normal
    forces in the region, the second most of what then is left, and so on.

    Args:
        count: Number of presses.
        angles: Restrict the region to these angles θ [deg].
        box: Restrict the region to the skin in this box, patient frame [m]: xmin,xmax,
            ymin,ymax,zmin,zmax, with inf on an open side.
        depth: Depth of a press [m]. By default the median of the recordings.
        spacing: Distance between places [m].
        output: Write the poses of the presses here, a trajectory CSV in the frame of
            the recordings.
        picture: Draw the uncertainty over the skin before and after the presses here.

    Example:
        ttus-opt next-press --surface surface.nc --probe ellipsoid:0.030,0.0125,0.018
        --trajectory press_fit.csv --picture next.png -o next.csv
    """
    from ttus_opt.fitting.batch import fit
    from ttus_opt.fitting.uncertainty import next_press as places
    from ttus_opt.fitting.uncertainty.field_uncertainty import uncertainty
    from ttus_opt.fitting.weights.weight_choice import choice_of, word_for
    from ttus_opt.report import plots

    sector = sector_of(angles, "--angles")
    limits = None if box is None else numbers(box, 6, "--box")
    word = word_for(None, problem.formulation, problem.further)
    with Stages(5) as begin:
        known = measured(surface, probe, recordings, grid.plan, begin)
        begin("fitting")
        choice = choice_of(
            *(word, known.scene, problem.formulation, problem.further),
            sampling=grid.sampling,
            strict=False,
        )
        tolerance = problem.tolerance
        solution = fit(
            choice.scene, choice.formulation, solver=problem.solver, tolerance=tolerance
        )
        begin("stating its uncertainty")
        stated = uncertainty(solution, choice.scene)
        begin("choosing places")
        found = places.next_press(
            stated, count, sector=sector, box=limits, depth=depth, spacing=spacing
        )
        if picture is not None:
            figure = plots.next_press_picture(found, known.recorded)
            plots.save_picture(figure, picture)
        if output is not None:
            place = known.patient.axis.scan_to_patient
            written = known.reading[1]
            reference = known.shell.reference
            written.as_recorded(found.poses, reference, place).save(output)
    tell({**found.as_dict(), "model": list(choice.lines)}, *_lines(found))


def _lines(found: NextPresses) -> list[str]:
    """A table of the presses."""
    from ttus_opt.report.document import Table

    before, after = found.region_std
    told = found.as_dict()["presses"]
    rows = [
        [
            str(k + 1),
            f"{p['theta_deg']:.1f}",
            f"{100 * p['z_m']:.1f}",
            ", ".join(f"{100 * v:.1f}" for v in p["point_m"]),
            ", ".join(f"{v:.2f}" for v in p["normal"]),
            f"{-100 * p['variance_reduction']:.1f}",
            f"{p['expected_force_N']:.2f}",
            f"{p['std_before_N']:.2f} → {p['std_after_N']:.2f}",
        ]
        for k, p in enumerate(told)
    ]
    return [
        fitted(Table(PRESS_COLUMNS, rows)),
        f"a press of {1e3 * found.depth:.1f} mm in the region: standard deviation "
        f"{before:.2f} N now, {after:.2f} N after these presses",
    ]

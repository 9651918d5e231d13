"""``ttus-opt experiment``: the paper's experiment on three phantom patients."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import Stages, print_json
from ttus_opt.cli.options import Json, listed, whole_numbers

EXAMPLE = (
    "ttus-opt experiment --torso ct_skin_mm.ply --formulations "
    "eq10,coulomb_global,depth_map -o results"
)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("experiment", epilog=f"Example: {EXAMPLE}")(experiment)


def experiment(
    output: Annotated[
        Path,
        typer.Option(
            "-o", "--output", help="Folder; a second call goes on where one stopped."
        ),
    ] = Path("experiment-results"),
    formulations: Annotated[
        str,
        typer.Option(
            help="Compared: names or paths of own files, separated by commas."
        ),
    ] = "eq10,coulomb_global,depth_map,depth_map_coulomb",
    weight: Annotated[
        float,
        typer.Option(help="λ_f = λ_τ of formulations that do not choose their own."),
    ] = 1.0,
    weights: Annotated[
        str,
        typer.Option(
            help="auto: these once more, with weights chosen from the recordings; "
            "given: not.",
        ),
    ] = "given",
    torso: Annotated[
        Path | None,
        typer.Option(help="A scan whose skin the third patient gets; else made up."),
    ] = None,
    torso_unit: Annotated[str, typer.Option(help="Unit of that scan.")] = "mm",
    patients: Annotated[
        str,
        typer.Option(help="Only these: lean, stout, and scanned or average."),
    ] = "",
    shape: Annotated[
        str, typer.Option(help="Voxels in r, θ, z: n_r,n_theta,n_z.")
    ] = "48,120,60",
    resolution: Annotated[
        float,
        typer.Option(help="Spacing of the finite elements: 1 is fine, 3 a quick look."),
    ] = 1.4,
    comparators: Annotated[
        str,
        typer.Option(help="Also other ways to render: names, or all."),
    ] = "",
    jobs: Annotated[
        int, typer.Option(help="Patients and settings at the same time (joblib).")
    ] = 1,
    dask: Annotated[
        str,
        typer.Option(
            help="Address of a dask scheduler for them, host:port; its workers must "
            "see the folder."
        ),
    ] = "",
    json: Json = False,
) -> None:
    """Simulate three patients, fit with and without forces, report every error."""
    from ttus_opt.experiment import Plan, n_stages, run
    from ttus_opt.experiment.report import summary
    from ttus_opt.report.document import markdown

    n_r, n_theta, n_z = whole_numbers(shape, 3, "--shape")
    plan = Plan(
        (n_r, n_theta, n_z),
        listed(formulations),
        weight,
        resolution,
        torso,
        torso_unit,
        listed(patients),
        listed(comparators),
        weights,
        jobs,
        dask,
    )
    with Stages(n_stages(plan)) as begin:
        result = run(output, plan, progress=begin)
    if json:
        print_json({**result.as_dict(), "report": str(output / "report.md")})
        return
    typer.echo("\n\n".join(map(markdown, summary(result))))
    typer.echo(f"\nreport.md, report.html, results.json and figures in {output}/")

"""``ttus-opt demo``: the whole method on the bundled example."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ttus_opt.cli.console import Stages, print_json
from ttus_opt.cli.options import Json, whole_numbers


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("demo", epilog="Example: ttus-opt demo -o demo")(demo)


def demo(
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for pictures and report.")
    ] = Path("demo"),
    shape: Annotated[
        str, typer.Option(help="Voxels in r, θ, z: n_r,n_theta,n_z.")
    ] = "48,120,60",
    json: Json = False,
) -> None:
    """Scan to surface to field to errors, on the bundled example, with pictures."""
    from ttus_opt import demo as pipeline
    from ttus_opt.report import tables as report

    n_r, n_theta, n_z = whole_numbers(shape, 3, "--shape")
    with Stages(pipeline.N_STAGES) as begin:
        result = pipeline.run(output, shape=(n_r, n_theta, n_z), progress=begin)
    if json:
        print_json(result.as_dict())
        return
    typer.echo(report.error_table(result.comparisons))
    typer.echo(f"\n{result.seconds:.0f} s; pictures, fields and report.md in {output}/")

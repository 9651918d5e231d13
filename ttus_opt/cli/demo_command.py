"""``ttus-opt demo``: the whole method on the bundled example."""

from __future__ import annotations

from pathlib import Path

import typer

from ttus_opt.cli.console import Stages, print_json
from ttus_opt.cli.options import whole_numbers


def demo(
    output: Path = Path("demo"),
    shape: str = "48,120,60",
    json: bool = False,
) -> None:
    """Scan to surface to field to errors, on the bundled example, with pictures.

    Args:
        output: Folder for pictures and report.
        shape: Voxels in r, θ, z: n_r,n_theta,n_z.

    Example:
        ttus-opt demo -o demo
    """
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

"""``ttus-opt demo``: the whole method on the bundled example."""

from __future__ import annotations

from pathlib import Path

from ttus_opt.cli.console import Stages, fitted, tell
from ttus_opt.cli.options import voxel_counts


def demo(
    output: Path = Path("demo"),
    shape: str = "48,120,60",
    weights: str = "auto",
) -> None:
    """Run the whole method on the bundled example, from scan to errors.

    Args:
        output: Folder for pictures and report.
        shape: Voxels in r, θ, z: n_r,n_theta,n_z.
        weights: auto: weights of eq. 10 by marginal likelihood; own: 0.01.

    Example:
        ttus-opt demo -o demo
    """
    from ttus_opt.report.tables import error_table
    from ttus_opt.session import demo as pipeline

    with Stages(pipeline.N_STAGES) as begin:
        result = pipeline.run(
            output, shape=voxel_counts(shape), weights=weights, progress=begin
        )
    line = f"\n{result.seconds:.0f} s; pictures, fields and report.md in {output}/"
    tell(result.as_dict(), fitted(error_table(result.comparisons)), line)

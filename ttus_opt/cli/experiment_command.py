"""``ttus-opt experiment``: the paper's experiment on three phantom patients."""

from __future__ import annotations

from pathlib import Path

from ttus_opt.cli.console import Stages, tell
from ttus_opt.cli.options import listed, voxel_counts


def experiment(
    output: Path = Path("experiment-results"),
    formulations: str = "eq10,coulomb_global,depth_map,depth_map_coulomb",
    weight: float = 1.0,
    weights: str = "given",
    torso: Path | None = None,
    torso_unit: str = "mm",
    patients: str = "",
    shape: str = "48,120,60",
    resolution: float = 1.4,
    comparators: str = "",
    jobs: int = 1,
    dask: str = "",
    json: bool = False,
) -> None:
    """Simulate three patients, fit with and without forces, report every error.

    Args:
        output: Folder; a second call goes on where one stopped.
        formulations: Compared: names or paths of own files, separated by commas.
        weight: λ_f = λ_τ of formulations that do not choose their own.
        weights: auto: these once more, with weights chosen from the recordings; recipe:
            and what the recipe chooses (ttus-opt fit --weights); given: not.
        torso: A scan whose skin the third patient gets; else made up.
        torso_unit: Unit of that scan.
        patients: Only these: lean, stout, and scanned or average.
        shape: Voxels in r, θ, z: n_r,n_theta,n_z.
        resolution: Spacing of the finite elements: 1 is fine, 3 a quick look.
        comparators: Also other ways to render: names, or all.
        jobs: Patients and settings at the same time (joblib).
        dask: Address of a dask scheduler for them, host:port; its workers must see the
            folder.

    Example:
        ttus-opt experiment --torso ct_skin_mm.ply --formulations
        eq10,coulomb_global,depth_map -o results
    """
    from ttus_opt.experiment import Plan, n_stages, run
    from ttus_opt.experiment.report import summary
    from ttus_opt.report.document import markdown

    plan = Plan(
        voxel_counts(shape),
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
    facts = {**result.as_dict(), "report": str(output / "report.md")}
    text = "" if json else "\n\n".join(map(markdown, summary(result)))
    where = f"\nreport.md, report.html, results.json and figures in {output}/"
    tell(facts, text, where, json=json)

"""``ttus-opt experiment``: the paper's experiment on three phantom patients."""

from __future__ import annotations

from pathlib import Path

from ttus_opt.cli.console import Stages, fitted, tell, to_machine
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
    uncertainty: bool = False,
    refine: bool = False,
) -> None:
    """Simulate three patients, fit with and without forces, and report all errors.

    Args:
        output: Folder of the results; a second call continues there.
        formulations: Formulations to compare: names, or paths of your own files,
            separated by commas.
        weight: λ_f = λ_τ of formulations that do not choose their own.
        weights: given: --weight alone; auto: fit again with weights chosen from the
            recordings, where a formulation allows it; default: also the model that
            ttus-opt fit takes without an option.
        torso: Scan whose skin the third patient gets; without it, that patient is
            invented.
        torso_unit: Unit of that scan: m, cm or mm.
        patients: Simulate only these, separated by commas: lean, stout, and average, or
            scanned with --torso.
        shape: Voxels in r, θ, z: n_r,n_theta,n_z.
        resolution: Spacing of the finite elements: 1 is fine, 3 a quick look.
        comparators: Also compare other models: names separated by commas, or all.
        jobs: Number of patients and settings at a time (extra parallel).
        dask: Address of a dask scheduler, host:port, whose workers can see the folder.
        uncertainty: Also check how well the stated uncertainty of fits agrees with
            their errors, for fits whose weights come from the recordings.
        refine: Also fit the default model to poses refined by the forces, as ttus-opt
            refine-poses does.

    Example:
        ttus-opt experiment --torso ct_skin_mm.ply --weights auto -o results
    """
    from ttus_opt.experiment import Plan, n_stages, run
    from ttus_opt.experiment.report import summary

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
        uncertainty,
        refine,
    )
    with Stages(n_stages(plan)) as begin:
        result = run(output, plan, progress=begin)
    facts = {**result.as_dict(), "report": str(output / "report.md")}
    said = "" if to_machine() else fitted(*summary(result))
    where = f"\nreport.md, report.html, results.json and figures in {output}/"
    tell(facts, said, where)

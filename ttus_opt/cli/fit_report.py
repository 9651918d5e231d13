"""What ``ttus-opt fit`` reports: for machines, and for people."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ttus_opt.fitting.checks.sanity import SanityReport
    from ttus_opt.fitting.weights.weight_choice import WeightChoice
    from ttus_opt.probe.conventions import Conventions
    from ttus_opt.probe.trajectory import Trajectory
    from ttus_opt.problem.solution import Solution


def summary(
    solution: Solution,
    output: Path,
    choice: WeightChoice,
    report: SanityReport | None,
) -> dict[str, Any]:
    """What the fit found, for machines."""
    solved = solution.verified_field is not None
    return {
        "status": solution.status.name.lower(),
        "advice": "" if solved else solution.status.value,
        "formulation": solution.formulation,
        "solver": solution.solver,
        "detail": solution.detail,
        "attempts": [
            {**asdict(a), "status": a.status.name.lower()} for a in solution.attempts
        ],
        "voxels": _n_voxels(solution),
        "objective": solution.objective,
        "costs": solution.costs,
        "weights": solution.weights,
        "kkt": None if solution.kkt is None else solution.kkt.as_dict(),
        "iterations": solution.iterations,
        "parameters": solution.parameters,
        "standard_errors": solution.standard_errors,
        "not_identified": solution.not_identified,
        "compressed": solution.compressed,
        "remarks": solution.remarks,
        "seconds": solution.timings.as_dict(),
        "output": str(output) if solved else None,
        "weights_chosen": choice.as_dict(),
        "sanity": None if report is None else report.as_dict(),
    }


def _n_voxels(solution: Solution) -> int:
    p = solution.program.variables["p"]
    return int(p.stop - p.start)


def solved_lines(solution: Solution, output: Path) -> list[str]:
    """How it was solved, for people."""
    worst = float("nan") if solution.kkt is None else solution.kkt.worst_relative
    times = solution.timings
    after = f" after {', '.join(map(str, solution.attempts))}"
    costs = ", ".join(f"{name} {cost:.4g}" for name, cost in solution.costs.items())
    solved = (
        f"{output}: {solution.formulation} by {solution.solver}"
        f"{after if solution.attempts else ''}, "
        f"{_n_voxels(solution):,} voxels, KKT {worst:.1e}, "
        f"{times.assembly:.1f} s assembly, {times.setup + times.solve:.1f} s solve"
        + (f", {times.compile:.1f} s compile" if times.compile > 0.05 else "")
    )
    compressed = [
        f"{name}: {had:,} rows compressed to {has:,}, exactly"
        for name, (had, has) in solution.compressed.items()
    ]
    objective = f"objective {solution.objective:.4g} ({costs})"
    return [solved, objective, *compressed, *solution.identified]


def how_read(recorded: Trajectory, conventions: Conventions) -> list[str]:
    """What was taken for granted of the recordings, in words."""
    frame, axes = conventions.frame, conventions.wrench_frame
    about = conventions.torque_about
    if not isinstance(about, str):
        about = ",".join(f"{v:g}" for v in about)
    torques = f"torques about: {about}"
    if not recorded.has_torque:
        torques = "no torques were measured: forces alone were fitted"
    return [f"poses in the {frame}'s frame, wrenches in the {axes}'s axes", torques]

"""``ttus-opt path``: one formulation for many weights, to choose them by."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.console import Stages, bars_shown, tell
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.scene_building import measured
from ttus_opt.cli.scene_options import ProblemOptions, SceneOptions
from ttus_opt.core import io
from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    import xarray as xr

    from ttus_opt.core.arrays import Array


#: Status of a path that was interrupted; what was done is written
INTERRUPTED = 130

#: Most weights of one option
MOST = 10_000


def path(
    surface: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    weight: Annotated[list[str], typer.Option(metavar="TERM[,TERM]=LOW:HIGH:COUNT")],
    output: Path,
    problem: ProblemOptions,
    grid: SceneOptions,
    held_out: Annotated[list[Path] | None, typer.Option(metavar="PATH")] = None,
    fields: bool = False,
    criteria: bool = False,
    picture: Path | None = None,
    jobs: int = 1,
    dask: str = "",
) -> None:
    """Solve for many weights at the cost of a few, and evaluate each.

    After Ctrl-C or a crash, the same command goes on from the points in its output.

    Args:
        weight: Weights of one term, or shared by several, logarithmically spaced, or a
            list such as 1e-4,1e-2. A second --weight makes a grid.
        output: Path file (.nc). Points that it holds of the same inputs are kept.
        held_out: Trajectory CSV on which every point is evaluated; may be repeated.
        fields: Save the potential of every point.
        criteria: Add evidence, cross-validation and errors on left-out presses.
        picture: Draw the L-curve and the held-out errors here.
        jobs: Number of points at a time (extra parallel), where points share no work:
            with friction, robust penalties or a solver of your own.
        dask: Address of a dask scheduler for them, host:port.

    Example:
        ttus-opt path --surface surface.nc --probe ellipsoid:0.030,0.0125,0.018
        --trajectory press_fit.csv --held-out press_test.csv --weight
        force,torque=1e-4:1e2:25 -o path.nc --picture path.png
    """
    from ttus_opt.fitting.checks.zero_check import warn_of_zero
    from ttus_opt.fitting.path.path_dataset import best_weights, write_solution_path
    from ttus_opt.fitting.path.solution_path import PathRun, solution_path

    weights, options, plan = read_weights(weight), problem.further, grid.plan
    others = held_out or []
    if len({file.name for file in others}) < len(others):
        raise InputError("two --held-out files have the same name: rename one")
    extras = ["potential"] * fields + ["criteria"] * criteria
    if fields:
        points = math.prod(len(values) for values in weights.values())
        io.check_output(output, size=8 * points * math.prod(plan.shape))
    run = PathRun(output, jobs, dask, bars_shown())
    with Stages(2) as begin:
        known = measured(surface, probe, recordings, plan, begin)
        warn_of_zero(known.scene)
        unseen = {}
        for file in others:
            one = replace(recordings, trajectory=[file])
            unseen[file.name] = one.read(one.as_written(), known.shell, known.patient)
    found = solution_path(
        problem.name,
        known.scene,
        weights=weights,
        held_out=unseen,
        solver=problem.solver,
        tolerance=problem.tolerance,
        extras=extras,
        run=run,
        **options,
    )
    found.attrs |= {
        "probe": probe.name,
        "trajectories": ", ".join(recordings.names),
        "conventions": json.dumps(asdict(recordings.conventions)),
    }
    found = _with_names(found, [one.stem for one in recordings.trajectory])
    write_solution_path(found, output)
    if picture is not None and not bool(found["objective"].isnull().all()):
        from ttus_opt.report import plots

        plots.save_picture(plots.weight_path(found), picture)
    best = best_weights(found)
    tell(_summary(found, best, output), *_lines(found, best, output))
    if found.attrs["points_done"] < found.attrs["points"]:
        raise typer.Exit(INTERRUPTED)
    if not _solved(found):
        typer.echo(f"error: no point was solved: see residuals in {output}", err=True)
        raise typer.Exit(1)


def read_weights(given: Sequence[str]) -> dict[str | tuple[str, ...], Array]:
    """Weights as typed: names, an equals sign, a range or a list.

    Raises:
        InputError: Something else.

    >>> read_weights(["force,torque=1:100:3"])
    {('force', 'torque'): array([  1.,  10., 100.])}
    """
    found: dict[str | tuple[str, ...], Array] = {}
    for text in given:
        names, equals, values = text.partition("=")
        terms = tuple(name.strip() for name in names.split(","))
        numbers = _values(values)
        if not (equals and all(terms)) or numbers is None:
            raise InputError(
                "--weight takes TERM=LOW:HIGH:COUNT with 0 < LOW < HIGH, or "
                f"TERM=VALUE,VALUE with positive numbers, got {text!r}"
            )
        if terms in found:
            raise InputError(
                f"--weight {names} is given twice: give all values at once"
            )
        found[terms] = numbers
    return found


def _values(text: str) -> Array | None:
    """LOW:HIGH:COUNT, even over the logarithm, or positive numbers; None for others."""
    import numpy as np

    try:
        if ":" not in text:
            values = [float(value) for value in text.split(",")]
            return np.array(values) if all(0.0 < v < math.inf for v in values) else None
        low, high, count = text.split(":")
        first, last, number = float(low), float(high), int(count)
    except ValueError:
        return None
    able = 0.0 < first < last < math.inf and 2 <= number <= MOST
    return np.geomspace(first, last, number) if able else None


def _summary(found: xr.Dataset, best: dict[str, float], output: Path) -> dict[str, Any]:
    variables = {
        str(name): {
            "dims": list(one.dims),
            "units": one.attrs.get("units", "1"),
            "values": one.to_numpy(),
        }
        for name, one in found.variables.items()
        if name not in ("potential", "r", "theta", "z")
    }
    return {
        "formulation": found.attrs["title"].removeprefix("solution path of "),
        "solver": found.attrs["solver"],
        "points": found.attrs["points"],
        "points_done": found.attrs["points_done"],
        "points_solved": _solved(found),
        "worst_kkt": float(found["kkt_residual"].max()),
        "seconds": float(found["seconds"].sum()),
        "best_weights": best or None,
        "variables": variables,
        "output": str(output),
    }


def _with_names(found: xr.Dataset, names: Sequence[str]) -> xr.Dataset:
    """Recordings by the names of their files, where each file is one."""
    if found.sizes.get("recording") != len(names) or len(set(names)) < len(names):
        return found
    return found.assign_coords(recording=("recording", list(names), {"units": "1"}))


def _solved(found: xr.Dataset) -> int:
    return int((found["status"] == 0).sum())


def _lines(found: xr.Dataset, best: dict[str, float], output: Path) -> list[str]:
    solved = (
        f"{output}: {_solved(found)} of {found.attrs['points']} points solved by "
        f"{found.attrs['solver']}, KKT at most "
        f"{float(found['kkt_residual'].max()):.1e}, "
        f"{float(found['seconds'].sum()):.1f} s"
    )
    if not best:
        return [solved]
    names = {f"{name}_weight": value for name, value in best.items()}
    where = {dim: names[str(dim)] for dim in found["status"].dims}
    at = found.sel(where, method="nearest")
    least = (
        "smallest held-out error at "
        + ", ".join(f"{name} weight {value:.3g}" for name, value in best.items())
        + f": force {float(at['held_out_force_magnitude_error'].mean()):.3f} N, "
        f"{float(at['held_out_force_angle_error'].mean()):.1f}°; torque "
        f"{float(at['held_out_torque_magnitude_error'].mean()):.1f} mN m, "
        f"{float(at['held_out_torque_angle_error'].mean()):.1f}°"
    )
    return [solved, least]

"""A path of weights: one formulation solved for many weights by few solves.

For one field without limits, the fields of all weights are combinations of a few
response fields (`ttus_opt.solvers.dual.weight_sweep`). With limits, the working set of
one point starts the next; other solvers keep their state. Every point is verified by
its own residuals like any other fit.
"""

from __future__ import annotations

import sys
import warnings
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.blas_threads import one_blas_thread
from ttus_opt.errors import InputError, TtusWarning
from ttus_opt.fitting.path_dataset import PathRecord
from ttus_opt.fitting.path_solvers import point_solver
from ttus_opt.fitting.weight_grid import Index, WeightGrid, Weights
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import Scene
from ttus_opt.solvers.base import Request, Solver

if TYPE_CHECKING:
    import xarray as xr

#: Held-out recordings: one, several, or several by name
HeldOut = Trajectory | Sequence[Trajectory] | Mapping[str, Trajectory]

#: Optional contents of a path
EXTRAS = ("potential", "criteria")


def solution_path(
    formulation: str | Path | Formulation,
    scene: Scene | None = None,
    *,
    weights: Weights,
    held_out: HeldOut = (),
    solver: str | Path | Solver = "auto",
    tolerance: float = 1e-6,
    extras: Collection[str] = (),
    progress: bool = False,
    **options: Any,
) -> xr.Dataset:
    """Solve a formulation for many weights.

    An interrupt (Ctrl-C) ends the path early: finished points are kept, and a
    `TtusWarning` gives their number.

    Args:
        formulation: A name, a path to a file with ``build``, or a Formulation.
        scene: Patient, probe and measurements; optional with a Formulation.
        weights: Values by term, ``{"force": np.logspace(-4, 2, 25)}``; a tuple of names
            for terms with a common weight, several entries for a grid. Other terms keep
            their weights.
        held_out: Recordings with wrenches, on which every point is evaluated.
        solver: As in `ttus_opt.fit`.
        tolerance: Largest relative KKT residual of a solution [–].
        extras: "potential" keeps every point's field; "criteria" adds evidence,
            generalised cross-validation, and errors on presses left out in turn, for
            one field without limits. They take more response fields with larger
            weights, on a fine grid ten times as many as the path.
        progress: Whether to show a progress bar.
        options: Options of the formulation.

    Returns:
        Over one dimension per entry of ``weights`` (``force_weight``): status, KKT
        residual, objective, value of every term, residual of every fitted recording,
        errors on held-out recordings, parameters (of the minimiser, whether or not the
        data determine them), seconds and ``extras``; with units, NaN where a point was
        not solved. `write_solution_path` writes it,
        `ttus_opt.report.plots.weight_path` draws it.

    Raises:
        InputError: Unknown formulation, option, solver, term or extra, weights that are
            not positive, held-out recordings without wrenches, or criteria of a
            problem that has none.
        SolverUnavailableError: The solver's package is not installed.
    """
    declared = _declared(formulation, scene, options)
    grid = WeightGrid.of(weights, [term.name for term in declared.terms])
    for extra in extras:
        if extra not in EXTRAS:
            raise InputError(f"unknown extra {extra!r}: choose {' or '.join(EXTRAS)}")
    record = PathRecord(
        declared, grid, _named(held_out), tolerance, keep_fields="potential" in extras
    )
    request = Request(tolerance)
    doubts = declared.not_identifiable()
    declared = declared.with_neutral(doubts)
    first = declared.with_weights(**grid.at((0,) * len(grid.axes)))
    solve = point_solver(first, solver, request)
    if "criteria" in extras:
        last = tuple(n - 1 for n in grid.shape)
        solve.prepare_criteria(declared.with_weights(**grid.at(last)))
    order = grid.from_both_ends() if solve.common else grid.from_the_prior()
    done = 0
    # a common basis makes matrices small
    threads = one_blas_thread() if solve.common else nullcontext()
    try:
        with threads:
            for index in _shown(order, progress):
                weighted = declared.with_weights(**grid.at(index))
                record.add(index, solve(weighted), solve.criteria(weighted))
                done += 1
    except KeyboardInterrupt:
        if not done:
            raise
        warnings.warn(
            f"interrupted after {done} of {grid.size} points of the path: the others "
            "are missing",
            TtusWarning,
            stacklevel=2,
        )
    return record.dataset()


def _declared(
    formulation: str | Path | Formulation,
    scene: Scene | None,
    options: Mapping[str, Any],
) -> Formulation:
    if scene is None:
        if not isinstance(formulation, Formulation):
            raise InputError("solution_path needs a scene with a formulation's name")
        scene = formulation.scene
    declared = shelf.load(formulation, scene, **options)
    if declared.scene is not scene:
        raise InputError(
            "the formulation belongs to another scene: build it for this one"
        )
    return declared


def _named(held_out: HeldOut) -> dict[str, Trajectory]:
    """Held-out recordings by name.

    Raises:
        InputError: Something else, or a recording without wrenches.
    """
    if isinstance(held_out, Trajectory):
        held_out = [held_out]
    if not isinstance(held_out, Mapping):
        held_out = {f"held out {i + 1}": one for i, one in enumerate(held_out)}
    for name, one in held_out.items():
        if not isinstance(one, Trajectory):
            raise InputError(
                f"{name} must be a Trajectory, got {type(one).__name__}: read it with "
                "read_trajectory"
            )
        if not one.has_wrench:
            raise InputError(
                f"{name} has no wrench to compare with: add fx,fy,fz, and "
                "tx,ty,tz where torques were measured"
            )
    return dict(held_out)


def _shown(order: Sequence[Index], progress: bool) -> Iterator[Index]:
    """The points, with a progress bar on stderr if requested."""
    points: Iterable[Index] = order
    if progress:
        from tqdm import tqdm

        # into a file or pipe only for long work, and every few seconds
        watched = sys.stderr.isatty()
        points = tqdm(
            order,
            desc="weights",
            unit="point",
            file=sys.stderr,
            delay=1.0 if watched else 5.0,
            mininterval=0.2 if watched else 5.0,
        )
    yield from points

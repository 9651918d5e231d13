"""A path of weights: one formulation solved for many weights by few solves.

For one field without limits, the fields of all weights are combinations of a few
response fields (`ttus_opt.solvers.dual.weight_sweep`). With limits, the working set of
one point starts the next; other solvers keep their state. Every point is verified by
its own residuals like any other fit.
"""

from __future__ import annotations

import contextlib
import copy
import os
import sys
import warnings
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.contact.scene import Scene
from ttus_opt.core import optional
from ttus_opt.core.errors import InputError, TtusWarning, warn
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.fitting.path.path_dataset import PathRecord
from ttus_opt.fitting.path.path_file import PathFile, inputs_of
from ttus_opt.fitting.path.path_solvers import PointSolver, point_solver
from ttus_opt.fitting.path.task_pool import task_pool
from ttus_opt.fitting.path.weight_grid import Index, WeightGrid, Weights
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.formulation import Formulation, load
from ttus_opt.problem.solution import Solution
from ttus_opt.solvers.base import Request, Solver

if TYPE_CHECKING:
    import xarray as xr

#: Held-out recordings: one, several, or several by name
HeldOut = Trajectory | Sequence[Trajectory] | Mapping[str, Trajectory]

#: Optional contents of a path
EXTRAS = ("potential", "criteria")


#: A point's index, its solution and its criteria
Point = tuple[Index, Solution, Mapping[str, float]]
#: The formulation with the weights of a point
At = Callable[[Index], Formulation]


@dataclass(frozen=True)
class PathRun:
    """How a path is run.

    Attributes:
        file: Where to keep the path, as `write_solution_path` does, at the end and
            every half minute. Points that it holds already are not computed again; if
            it is of other inputs, a `TtusWarning` names them, and it is replaced.
        jobs: Processes for formulations that share no work between their points
            (extra parallel); for others, a `TtusWarning` says that it is not used.
        dask: Address of a dask scheduler, host:port, to use instead.
        progress: Whether to show a progress bar.
    """

    file: str | os.PathLike[str] | None = None
    jobs: int = 1
    dask: str = ""
    progress: bool = False

    def __post_init__(self) -> None:
        """Refuse fewer than one job."""
        if self.jobs < 1:
            raise InputError(f"jobs must be at least 1, got {self.jobs}")


def solution_path(
    formulation: str | Path | Formulation,
    scene: Scene | None = None,
    *,
    weights: Weights,
    held_out: HeldOut = (),
    solver: str | Path | Solver = "auto",
    tolerance: float = 1e-6,
    extras: Collection[str] = (),
    run: PathRun | None = None,
    **options: Any,
) -> xr.Dataset:
    """Solve a formulation for many weights.

    An interrupt (Ctrl-C) ends the path early: finished points are kept, and a
    `TtusWarning` gives their number. With a file, the same call goes on from them.

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
        run: Where the path is kept, processes, a progress bar; by default none of it.
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
            not positive, held-out recordings without wrenches, criteria of a problem
            that has none, or no scheduler that answers.
        SolverUnavailableError: The solver's package is not installed.
        MissingPackageError: joblib or dask is requested and not installed.
        FileError: The file cannot be written.
    """
    for extra in extras:
        if extra not in EXTRAS:
            raise InputError(f"unknown extra {extra!r}: choose {' or '.join(EXTRAS)}")
    run = run or PathRun()
    if scene is None:
        if not isinstance(formulation, Formulation):
            raise InputError("solution_path needs a scene with a formulation's name")
        scene = formulation.scene
    declared = load(formulation, scene, **options)
    grid = WeightGrid.of(weights, [term.name for term in declared.terms])
    unseen = _named(held_out)
    neutral = declared.with_neutral(declared.not_identifiable())

    def at(index: Index) -> Formulation:
        return neutral.with_weights(**grid.at(index))

    first = at((0,) * len(grid.axes))
    solve = point_solver(first, solver, Request(tolerance))
    inputs: dict[str, str] = {}
    if run.file is not None:
        inputs = inputs_of(first, grid, unseen, solver, tolerance, extras)
    keep_fields = "potential" in extras
    record = PathRecord(
        declared, grid, unseen, tolerance, keep_fields=keep_fields, inputs=inputs
    )
    kept = None if run.file is None else PathFile(run.file, record, inputs)
    order = grid.from_both_ends() if solve.common else grid.from_the_prior()
    left = [index for index in order if not record.has(index)]
    if "criteria" in extras and left:
        solve.prepare_criteria(at(tuple(n - 1 for n in grid.shape)))
    if not (run.jobs > 1 or run.dask):
        points = in_turn(solve, left, at)
    elif solve.independent:
        points = several_at_a_time(solve, left, at, run.jobs, run.dask)
    else:
        warn(
            f"the points of {declared.name} share their work: one process solves them, "
            "jobs and dask are not used"
        )
        points = in_turn(solve, left, at)
    _collect(_shown(points, record.done, grid.size, run.progress), record, kept)
    return record.dataset()


def _collect(
    points: Iterable[Point], record: PathRecord, kept: PathFile | None
) -> None:
    """Record the points, and keep them in the file whatever ends the path."""
    try:
        for point in points:
            record.add(*point)
            if kept is not None:
                kept.save_now_and_then()
    except KeyboardInterrupt:
        if not record.done:
            raise
        again = "" if kept is None else f"; the same call goes on from {kept}"
        warn(
            f"interrupted after {record.done} of {record.size} points of the path: the "
            f"others are missing{again}",
            2,
        )
    finally:
        if kept is not None:
            kept.save()


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


def _shown(
    points: Iterable[Point], done: int, size: int, progress: bool
) -> Iterator[Point]:
    """The points, with a progress bar on stderr if requested."""
    if progress:
        from tqdm import tqdm

        if done:
            tqdm.write(f"going on from {done} of {size} points", file=sys.stderr)
        # into a file or pipe only for long work, and every few seconds
        watched = sys.stderr.isatty()
        points = tqdm(
            points,
            desc="weights",
            unit="point",
            initial=done,
            total=size,
            file=sys.stderr,
            delay=1.0 if watched else 5.0,
            mininterval=0.2 if watched else 5.0,
        )
    yield from points


def in_turn(solve: PointSolver, points: Iterable[Index], at: At) -> Iterator[Point]:
    """Solve one point after the other, each from the state of those before."""
    for index in points:
        weighted = at(index)
        # a common basis makes matrices small
        with one_blas_thread() if solve.common else contextlib.nullcontext():
            yield index, solve(weighted), solve.criteria(weighted)


def several_at_a_time(
    solve: PointSolver, points: Iterable[Index], at: At, jobs: int, address: str
) -> Iterator[Point]:
    """Solve every point on its own, in any order.

    Args:
        solve: An independent solver, not used before.
        points: The points.
        at: The formulation at each.
        jobs: Processes on this machine.
        address: Address of a dask scheduler to use instead; "" for none.

    Raises:
        MissingPackageError: joblib or dask is not installed.
        InputError: No scheduler answers.
    """
    delayed = optional.load("joblib", "parallel").delayed
    told: set[str] = set()
    with task_pool(jobs, address) as run:
        tasks = (delayed(_alone)(solve, index, at(index)) for index in points)
        for index, solution, messages in run(tasks):
            for message in messages:
                if message not in told:
                    warn(message, 2)
                told.add(message)
            yield index, solution, {}


def _alone(
    solve: PointSolver, index: Index, weighted: Formulation
) -> tuple[Index, Solution, list[str]]:
    """A point by a solver without state, with the warnings it gives."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", TtusWarning)
        # threads of a cluster in this process would share it
        solution = copy.copy(solve)(weighted)
    told = [str(one.message) for one in caught if issubclass(one.category, TtusWarning)]
    return index, solution, told

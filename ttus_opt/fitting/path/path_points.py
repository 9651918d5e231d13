"""The points of a path in turn, or several at a time."""

from __future__ import annotations

import copy
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping

from ttus_opt.core import optional
from ttus_opt.core.blas_threads import one_blas_thread
from ttus_opt.core.errors import TtusWarning, warn
from ttus_opt.fitting.path.path_solvers import PointSolver
from ttus_opt.fitting.path.task_pool import task_pool
from ttus_opt.fitting.path.weight_grid import Index
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.solution import Solution

#: A point's index, its solution and its criteria
Point = tuple[Index, Solution, Mapping[str, float]]

#: The formulation with the weights of a point
At = Callable[[Index], Formulation]


def in_turn(solve: PointSolver, points: Iterable[Index], at: At) -> Iterator[Point]:
    """Solve one point after the other, each from the state of those before."""
    for index in points:
        weighted = at(index)
        if solve.common:
            with one_blas_thread():  # a common basis makes matrices small
                yield index, solve(weighted), solve.criteria(weighted)
        else:
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

"""Few rows by their dual: what is kept of directions changes nothing."""

from __future__ import annotations

import numpy as np
import pytest

from tests.solvers.own_terms import AlongZ
from tests.solvers.primal.test_limited_sum import FEW, made
from ttus_opt.arrays import Array
from ttus_opt.solvers.dual.options import DualOptions
from ttus_opt.solvers.primal import preconditioner as module
from ttus_opt.solvers.primal.conjugate_gradients import Pair
from ttus_opt.solvers.primal.least_squares import preconditioner
from ttus_opt.solvers.primal.options import PrimalOptions
from ttus_opt.solvers.primal.preconditioner import ConstraintPreconditioner


def fresh() -> tuple[ConstraintPreconditioner, Pair]:
    _, problem = made(AlongZ, False)
    split = problem.split
    columns = np.ones(split.few.columns.shape[1], dtype=bool)
    options = PrimalOptions(few_rows=FEW)
    built = preconditioner(split, columns, options, DualOptions())
    rng = np.random.default_rng(2)
    shape = len(split.few.b), len(split.few.t)
    return built, Pair(*(rng.normal(size=n) for n in shape))


def test_fields_kept_of_directions_stand_for_solves(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept, rest = fresh()
    system, spent = kept._system, []
    own = type(system).response

    def counted(self: object, y: Array, *more: float) -> Array:
        spent.append(1)
        return own(system, y, *more)

    monkeypatch.setattr(type(system), "response", counted)
    first = kept.apply(rest)
    known = len(kept._responses.kept)
    assert known == len(kept._subspace) > 0
    assert len(spent) == known  # those of the products, and none for the step
    spent.clear()
    again = kept.apply(rest)
    assert not spent
    np.testing.assert_allclose(again.p, first.p, atol=1e-6 * np.abs(first.p).max())
    expected = system.prior(rest.p) + own(system, again.y)
    size = np.abs(expected).max()
    np.testing.assert_allclose(again.p, expected, atol=1e-5 * size)


def test_of_many_directions_no_fields_are_kept(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(module, "MOST_FIELDS", 0)
    built, rest = fresh()
    built.apply(rest)
    assert len(built._subspace) > 0 and not built._responses.kept

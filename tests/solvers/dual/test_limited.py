"""Attempts that become more exact, and what a working set's end is told as."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tests.kit import small_scene
from tests.oracles.dense import minimiser
from ttus_opt.problem import formulation
from ttus_opt.solvers.base import Candidate, Claim, Request
from ttus_opt.solvers.dual import limited
from ttus_opt.solvers.dual.data import duals_without_limits
from ttus_opt.solvers.dual.limited import Limited
from ttus_opt.solvers.dual.limits import Multipliers, SpokeLimits
from ttus_opt.solvers.dual.working_set import WorkingSet
from ttus_opt.solvers.primal.limited_sum import LimitedSum

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=3)
PROGRAM = formulation.load("eq10", SCENE).compile()


EXACT = minimiser(PROGRAM)


class Loaded(Limited):
    """Holds a program, and answers as told where it has no limits."""

    reply = None

    def _load(self, program):
        self._problem = LimitedSum(program, SpokeLimits.of(program), None)

    def _unlimited(self, accuracy):
        return self.reply(accuracy)

    def facing(self, limits):
        """The answer where limits contradict each other."""
        self._problem = replace(self._problem, limits=limits)
        return self._contradiction()

    def ended(self, end):
        """The answer where the iteration ends so."""
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(limited, "primal_dual_active_set", lambda *_: end)
            return self._limited(None)


def loaded(tolerance=1e-6, reply=None, time_limit=None):
    made = Loaded(None, Request(tolerance=tolerance, time_limit=time_limit))
    made.update(PROGRAM)
    made.reply = reply
    return made


@pytest.mark.parametrize("claim", [Claim.DONE, Claim.GAVE_UP])
def test_accuracy_is_tightened_until_it_holds_and_anew_in_every_solve(claim):
    asked = []

    def attempt(accuracy):
        asked.append(accuracy.rtol)
        x = EXACT * (1.0 + 1e5 * accuracy.rtol)
        return Candidate(x, duals_without_limits(PROGRAM, x), 2, claim)

    made = loaded(reply=attempt)
    for _ in range(2):
        found = made.solve()
        assert asked == pytest.approx([1e-8, 1e-11])  # margin times tolerance at first
        assert (found.iterations, found.claim) == (4, claim)
        np.testing.assert_allclose(found.x, EXACT, rtol=1e-5)
        asked.clear()


@pytest.mark.parametrize(("errors", "kept"), [([0.1, 0.2], 0.1), ([4, 3, 2, 1], 1)])
def test_it_ends_where_an_answer_is_no_better_or_after_four(errors, kept):
    left = iter(errors)
    found = loaded(reply=lambda _: Candidate((1 + next(left)) * EXACT)).solve()
    assert next(left, None) is None
    np.testing.assert_allclose(found.x, (1 + kept) * EXACT)


def test_an_attempt_that_ran_out_of_time_is_the_last():
    def attempt(accuracy):
        assert accuracy.deadline is not None
        return Candidate(2.0 * EXACT, iterations=1, claim=Claim.TIME_LIMIT)

    found = loaded(reply=attempt, time_limit=100.0).solve()
    assert (found.iterations, found.claim) == (1, Claim.TIME_LIMIT)


def crossed(by):
    """Four voxels, one of which must be at least 5 and at most 5 - by."""
    lower, upper = np.full(4, -np.inf), np.full(4, np.inf)
    lower[2], upper[2] = 5.0, 5.0 - by
    return SpokeLimits(
        (4, 1, 1), lower, upper, np.zeros(4, bool), np.full(4, -np.inf), {}
    )


def test_a_contradiction_counts_beside_the_largest_limit():
    assert loaded(1e-6).facing(crossed(4e-6)) is None
    found = loaded(1e-6).facing(crossed(6e-6))
    assert (found.x, found.claim) == (None, Claim.INFEASIBLE)
    assert "6e-06" in found.detail


@pytest.mark.parametrize(
    ("settled", "late", "claim"),
    [
        (True, False, Claim.DONE),
        (True, True, Claim.DONE),
        (False, True, Claim.TIME_LIMIT),
        (False, False, Claim.GAVE_UP),
    ],
)
def test_an_iterations_end_is_told(settled, late, claim):
    active = WorkingSet(np.array([1, 0, -1], np.int8), np.array([True, False, False]))
    zeros = np.zeros_like(EXACT)
    end = SimpleNamespace(
        settled=settled, late=late, sets=4, steps=9, active=active, p=EXACT,
        multipliers=Multipliers(zeros, zeros),
    )  # fmt: skip
    found = loaded().ended(end)
    assert (found.claim, found.iterations) == (claim, 9)
    assert found.detail == "4 working sets, 3 active limits"

"""Solve, check, tighten: with a package that does what it is told, step by step."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, field
from types import SimpleNamespace

import numpy as np
import pytest

from tests.solvers.problems import program, term
from ttus_opt.solvers import base, verified
from ttus_opt.solvers.base import Candidate, Claim, Request
from ttus_opt.solvers.verified import LEAST, Verified, seconds_left

TARGET = np.array([1.0, -2.0, 3.0])
PROGRAM = program([term(np.eye(3), TARGET), term(np.eye(3), 2 * TARGET, name="two")])
ANSWER = 1.5 * TARGET

Reply = Callable[[float], Candidate]


def off(error, claim=Claim.DONE, iterations=7):
    """The answer but for a relative error."""
    return Candidate(ANSWER * (1 + error), iterations=iterations, claim=claim)


@dataclass
class Package(Verified):
    """Answers as told, and remembers what it was asked for."""

    reply: Reply
    request: Request
    pauses: int = 0
    asked: list[float] = field(default_factory=list)
    limits: list[float | None] = field(default_factory=list)

    def __post_init__(self):
        self.continuations = self.pauses
        Verified.__init__(self, None, self.request)
        self.update(PROGRAM)

    def _load(self, program):
        pass

    def _attempt(self, eps, deadline):
        self.asked.append(eps)
        self.limits.append(deadline)
        return self.reply(eps)


def test_an_answer_that_falls_short_is_tightened_until_it_holds():
    """A package whose own measure is a thousand times too kind."""
    package = Package(lambda eps: off(1000 * eps), Request(1e-6))
    found = package.solve()
    assert np.abs(found.x / ANSWER - 1).max() < 1e-6
    assert found.iterations == 7 * len(package.asked)
    assert (np.diff(package.asked) < 0).all()
    # once held, the tolerance stays: the next solve asks for it at once
    count = len(package.asked)
    package.solve()
    assert package.asked[count:] == [package.asked[count - 1]]


def test_tightening_is_not_for_ever_and_the_best_is_kept():
    errors = iter([9e-5, 3e-5, 6e-5, 5e-5, 4e-5])
    package = Package(lambda eps: off(next(errors)), Request(1e-6))
    found = package.solve()
    assert len(package.asked) == Verified.tightenings + 1
    np.testing.assert_allclose(found.x, ANSWER * (1 + 3e-5), rtol=1e-12)
    assert all(b <= LEAST * a for a, b in itertools.pairwise(package.asked))


def test_rounding_ends_the_tightening():
    package = Package(lambda eps: off(1e-2), Request(1e-6))
    assert package.solve().claim is Claim.DONE
    assert package.asked[-1] == Package.floor
    assert len(package.asked) < Verified.tightenings + 1


def test_what_is_paused_goes_on_as_often_as_it_may():
    package = Package(lambda eps: off(1e-2, Claim.PAUSED), Request(1e-6), pauses=3)
    assert package.solve().claim is Claim.PAUSED
    assert package.asked == [1e-6] * 4  # not tightened: it was not done


def test_an_impatient_package_ends_where_an_answer_is_no_better():
    class Impatient(Package):
        patient = False

    errors = iter([9e-5, 3e-5, 6e-5])
    package = Impatient(lambda eps: off(next(errors)), Request(1e-6))
    np.testing.assert_allclose(package.solve().x, ANSWER * (1 + 3e-5), rtol=1e-12)
    assert next(errors, None) is None


@pytest.mark.parametrize("claim", [Claim.INFEASIBLE, Claim.GAVE_UP])
def test_what_is_not_done_is_not_tried_again(claim):
    package = Package(lambda eps: Candidate(None, claim=claim), Request(1e-6))
    assert package.solve().claim is claim
    assert len(package.asked) == 1


def test_time_that_is_up_is_said(monkeypatch):
    """Each look at the clock takes a second."""
    clock = itertools.count(0.0)
    own = SimpleNamespace(perf_counter=clock.__next__)  # of no other thread
    for module in (verified, base):
        monkeypatch.setattr(module, "time", own)
    package = Package(lambda eps: off(1e-2), Request(1e-6, time_limit=2.5))
    found = package.solve()
    assert package.limits == [2.5, 2.5]
    assert found.claim is Claim.TIME_LIMIT
    assert found.x is not None
    assert Package(lambda eps: off(0.0), Request(1e-6, 0.5)).solve().x is None
    now = next(clock)
    assert (seconds_left(now + 3.0), seconds_left(None)) == (2.0, None)

"""What packages behind qpsolvers say, in words, and what it claims."""

import pytest

from ttus_opt.solvers.base import Claim
from ttus_opt.solvers.packages.qp_packages import SOLVERS, Highs, claim_from


@pytest.mark.parametrize(
    ("words", "found", "claim"),
    [
        ("Solved", True, Claim.DONE),
        ("PrimalInfeasible", False, Claim.INFEASIBLE),
        ("DualInfeasible", False, Claim.UNBOUNDED),
        ("MaxTime", False, Claim.TIME_LIMIT),
        ("Status.PIQP_NUMERICS", False, Claim.GAVE_UP),
        ("", False, Claim.GAVE_UP),
    ],
)
def test_claims_from_words(words, found, claim):
    assert claim_from(words, found) is claim


@pytest.mark.parametrize("solver", SOLVERS, ids=lambda s: s.name)
def test_tolerances_follow_what_is_asked_for(solver):
    loose, tight = (solver.options(eps, 7.0) for eps in (1e-4, 1e-7))
    asked = {*solver.tolerances, *solver.absolute}
    assert all(tight[name] < loose[name] for name in asked)
    assert solver.capabilities.time_limit == (7.0 in tight.values())
    assert (solver.name == "highs") == isinstance(solver, Highs)


def test_an_interrupt_that_a_package_took_for_itself_goes_on():
    """OSQP and SCS end with these words; the answer so far is none."""
    for words in ("interrupted", "Interrupted", "OSQP_SIGINT"):
        with pytest.raises(KeyboardInterrupt):
            claim_from(words, True)

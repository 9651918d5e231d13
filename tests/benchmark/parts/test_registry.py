"""Parts by name."""

from tests.refusals import refuses
from ttus_opt.benchmark.parts.registry import SOLVERS, chosen
from ttus_opt.core.errors import InputError


def test_names():
    named = ["assembly", "live", "profile", "recursion", "rendering", "ripple"]
    assert chosen("all") == [SOLVERS, *named]
    assert chosen("ripple, solvers,ripple") == ["ripple", SOLVERS]
    for text in ("riple", "", "solvers,all"):
        refuses(InputError, "choose from solvers, assembly", chosen, text)

"""``ttus-opt solvers``: what a solver takes, in words."""

from ttus_opt.cli.list_commands import _takes
from ttus_opt.solvers import registry


def test_only_some_solvers_need_a_laplace_term():
    solvers = registry.solvers().values()
    general = [one for one in solvers if one.capabilities.any_terms]
    assert 0 < len(general) < len(solvers)
    for one in solvers:
        assert ("any terms" in _takes(one)) == (one in general)
        assert ("Laplace and measured rows" in _takes(one)) == (one not in general)

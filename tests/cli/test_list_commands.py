"""``ttus-opt solvers`` and ``formulations``: what there is, in 80 columns."""

import pytest

from ttus_opt.cli.list_commands import _letters
from ttus_opt.problem import formulation
from ttus_opt.solvers import registry


def test_only_some_solvers_need_a_laplace_term():
    solvers = registry.solvers().values()
    general = [one for one in solvers if one.capabilities.any_terms]
    assert 0 < len(general) < len(solvers)
    for one in solvers:
        assert ("A" in _letters(one)) == (one in general)
        assert set(_letters(one)) <= {*"AEIPTK·"}


def test_auto_is_told_with_installed_solvers_only(run, monkeypatch):
    solver = registry.solvers()["osqp"]
    monkeypatch.setattr(solver, "module", "no_such_package")
    told = run("solvers").out
    assert "osqp (osqp)" in told and "osqp" not in told[told.index("auto picks") :]


@pytest.mark.parametrize("name", ["solvers", "formulations"])
def test_lists_fit_80_columns_and_leave_nothing_out(run, name):
    told = run(name).out
    assert max(map(len, told.splitlines())) <= 80
    known = {"solvers": registry.solvers(), "formulations": formulation.available()}
    for one in known[name]:
        assert getattr(one, "name", one) in told
        for option in getattr(one, "options", ()):
            assert str(option) in told

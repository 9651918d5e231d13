"""The table of who takes what against what every solver says, installed or not."""

import pytest

from tests.solvers import taking
from tests.solvers.problems import bending_references, references
from tests.solvers.test_agreement import reduction
from ttus_opt.problem.formulation import available
from ttus_opt.problem.reduction import reduce
from ttus_opt.solvers.registry import solvers


@pytest.mark.parametrize("name", [info.name for info in available()])
def test_a_formulation_is_taken_by(name):
    program = reduction(name).program
    takers = [s.name for s in solvers().values() if not s.refusal(program)]
    written = taking.FORMULATIONS.get(name)
    assert written is not None, f"write into taking.py who takes {name}: {takers}"
    assert takers == taking.named(written)


@pytest.mark.parametrize(
    "reference", references() + bending_references(), ids=lambda r: r.name
)
def test_a_reference_problem_is_taken_by(reference):
    reduced = reduce(reference.program).program
    takers = [
        solver.name
        for solver in solvers().values()
        if not solver.refusal(
            reference.program if solver.capabilities.nonquadratic else reduced
        )
    ]
    assert takers == taking.named(taking.REFERENCES[reference.name])


def test_the_tables_know_every_name():
    assert set(taking.FORMULATIONS) == {info.name for info in available()}
    told = {reference.name for reference in references() + bending_references()}
    assert set(taking.REFERENCES) == told
    tabled = frozenset.union(*taking.FORMULATIONS.values())
    assert taking.named(tabled) == taking.named(solvers())


@pytest.mark.parametrize("name", taking.named(solvers()))
def test_a_solver_is_installed(name):
    """The one place where an absent solver is skipped; tests run over the others."""
    if not solvers()[name].installed:
        assert name not in taking.REQUIRED, f"{name} comes with the package"
        pytest.skip(f"{name} is absent: pip install {solvers()[name].pip_name}")

"""The test set of qpbenchmark: the problems it yields are this package's."""

import warnings
from pathlib import Path

import numpy as np
import pytest

from tests.kit import python

FILE = Path(__file__).resolve().parents[2] / "benchmarks" / "ttus.py"


@pytest.fixture(scope="module")
def test_set():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # its packages are full of deprecations
        pytest.importorskip("qpbenchmark", reason="qpbenchmark is not installed")
        from benchmarks import ttus

        made = ttus.Ttus()
        made.__doc_of_file__ = ttus.__doc__
        return made


def test_problems_are_sparse_named_and_solvable(test_set):
    import qpsolvers

    problems = {problem.name: problem for problem in test_set}
    assert len(problems) == 8
    for problem in problems.values():
        assert not problem.has_sparse or problem.P.format == "csc"
        assert problem.A.shape[0] > 0, "without equality rows some go through LSQR"
    answer = qpsolvers.solve_problem(problems["XXS_eq10"], solver="clarabel")
    assert answer.found
    assert answer.primal_residual() < 1e-6
    assert answer.dual_residual() < 1e-6
    assert abs(answer.duality_gap()) < 1e-6
    assert np.isfinite(answer.x).all()


def test_its_documented_command_runs(test_set, tmp_path):
    """As the test set's own docstring says it, for one problem and one solver."""
    line = next(v for v in test_set.__doc_of_file__.splitlines() if " run " in v)
    words = line.split()
    words[words.index("benchmarks/ttus.py")] = str(FILE)
    words[words.index("ttus.csv")] = str(tmp_path / "ttus.csv")
    program = "from qpbenchmark.benchmark import main; main()"
    limits = ["--problem", "XXS_eq10", "--solver", "osqp"]
    python("-c", program, *words[1:], *limits, cwd=tmp_path)
    rows = (tmp_path / "ttus.csv").read_text().splitlines()
    assert len(rows) == 1 + len(test_set.tolerances)
    assert (tmp_path / "ttus.md").read_text().startswith("# ")


def test_no_group_of_settings_passes_anything(test_set):
    assert set(test_set.tolerances) == set(test_set.solver_settings)
    assert max(t.gap for t in test_set.tolerances.values()) <= 1e-3

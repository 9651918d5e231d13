"""A run in its own process: a crash, an exception or a limit is a row."""

from dataclasses import replace

import pytest

from tests.benchmark.tiny import TINY, trapped
from tests.kit import small_scene
from ttus_opt.benchmark import isolation
from ttus_opt.benchmark.isolation import run_isolated
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.benchmark.row import Settings
from ttus_opt.fitting.batch import Fitter
from ttus_opt.problem.formulation import load
from ttus_opt.solvers.base import Request


def assembly():
    return parts()["assembly"].plan([TINY], Settings())[0]


@pytest.mark.slow
def test_crash_is_a_row(tmp_path):
    seen: list[str] = []
    spec = trapped(tmp_path, "import os\nos.abort()")
    (row,) = run_isolated(spec, tmp_path, None, lambda stage, since: seen.append(stage))
    assert row["status"] == "crashed"
    assert "SIGABRT during program" in row["detail"]
    assert row["solver"] == "osqp"
    assert row["seconds_first"] is None
    assert {"start", "warm-up"} <= set(seen)


@pytest.mark.slow
def test_exception_is_a_row_with_its_last_line(tmp_path):
    spec = trapped(tmp_path, "raise KeyError('my own mistake')")
    (row,) = run_isolated(spec, tmp_path)
    assert row["status"] == "refused"
    assert "KeyError: 'my own mistake'" in row["detail"]
    assert "trap.py, line 6" in row["detail"]


@pytest.mark.slow
def test_memory_limit_is_a_row(tmp_path):
    deed = "import time\nimport numpy\nkeep = numpy.ones(2**28)\ntime.sleep(60)"
    (row,) = run_isolated(trapped(tmp_path, deed), tmp_path, 2**30)
    assert row["status"] == "memory limit"
    assert row["peak_memory_bytes"] > 2**30


@pytest.mark.slow
def test_a_run_that_is_refused_at_last_tells_its_memory(tmp_path):
    """Refused by its own process, which had a size by then."""
    deed = """from ttus_opt.core.errors import InputError
raise InputError("not on this grid")"""
    (row,) = run_isolated(trapped(tmp_path, deed), tmp_path)
    assert (row["status"], row["detail"]) == ("refused", "not on this grid")
    assert row["peak_memory_bytes"] > 2**26


@pytest.mark.slow
def test_who_does_not_stop_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(isolation, "LATE_SECONDS", 0.5)
    deed = """import time
from ttus_opt.solvers.packages import closed_form
closed_form._Factorised.solve = lambda self: time.sleep(60)"""
    spec = replace(trapped(tmp_path, deed, "closed_form"), time_limit=1.0)
    (row,) = run_isolated(spec, tmp_path)
    assert row["status"] == "time limit"
    assert row["detail"] == "ended during first"


@pytest.mark.slow
def test_other_parts_fail_as_rows_as_well(tmp_path):
    gone = replace(TINY, name="gone", surface=str(tmp_path / "no.nc"))
    (row,) = run_isolated(replace(assembly(), case=gone), tmp_path)
    assert row["status"] == "refused"
    assert "no.nc" in row["detail"]
    assert row["peak_memory_bytes"] > 2**26
    (row,) = run_isolated(assembly(), tmp_path, 2**20)
    assert row["status"] == "memory limit"
    assert "memory limit: ended during" in str(parts()["assembly"].table([row]))
    assert not list(tmp_path.iterdir())


def test_compiling_and_assembling_may_take_longer():
    assert isolation._allowed("first", 100.0) == pytest.approx(205.0)
    assert isolation._allowed("again", 100.0) == pytest.approx(115.0)
    assert isolation._allowed("scene", 100.0) == isolation.PREPARATION
    assert isolation._allowed("scene", 2000.0) == pytest.approx(2205.0)


@pytest.mark.parametrize(
    ("formulation", "solver"), [("eq10", "osqp"), ("robust", "augmented_lagrangian")]
)
def test_an_ended_run_tells_the_residual_it_reached(tmp_path, formulation, solver):
    """What a solver reports on the way is what is left when its process is ended."""
    assert isolation._reached(tmp_path) == {}
    request = Request(told=Progress(tmp_path).reached)
    declared = load(formulation, small_scene())
    fitter = Fitter(declared, solver=solver, request=request)
    kkt = fitter.solve().kkt
    reached = isolation._reached(tmp_path)["residual_reached"]
    assert reached == pytest.approx(kkt.worst_relative, rel=1e-6)

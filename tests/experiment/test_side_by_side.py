"""Tasks side by side: each is done once, what was found is the same, dask by name."""

import contextlib
from dataclasses import replace

import pytest

from tests.refusals import refuses
from ttus_opt import experiment
from ttus_opt.core.errors import InputError, MissingPackageError
from ttus_opt.experiment import side_by_side
from ttus_opt.experiment.patients import patients
from ttus_opt.fitting.path.task_pool import task_pool

PLAN = experiment.Plan(
    (16, 48, 24),
    ("eq10",),
    comparators=("kelvin_voigt",),
    jobs=2,
    weights="auto",
    uncertainty=True,
)


@pytest.fixture
def done(monkeypatch):
    """What is done, by threads, that share this list; nothing is computed."""
    joblib = pytest.importorskip("joblib")
    seen: list[tuple[str, str]] = []

    class Fits:
        stamp = ""

        def __init__(self, examination, folder, *_):
            self.folder = folder

        def fitted(self, setting):
            seen.append((self.folder.name, setting.name))

    @contextlib.contextmanager
    def threads(jobs, address):
        yield joblib.Parallel(jobs, "threading", return_as="generator_unordered")

    def noted(name):
        return lambda fits, *_: seen.append((fits.folder.name, name))

    monkeypatch.setattr(side_by_side, "task_pool", threads)
    monkeypatch.setattr(side_by_side, "PatientFits", Fits)
    monkeypatch.setattr(side_by_side, "boundary_errors", noted("boundary"))
    monkeypatch.setattr(
        side_by_side,
        "stated_uncertainty",
        lambda fits, setting, *_: noted(f"uncertainty of {setting.name}")(fits),
    )
    monkeypatch.setattr(
        side_by_side.rivals, "rival", lambda fits, name, *_: noted(name)(fits)
    )
    monkeypatch.setattr(
        side_by_side, "examine", lambda who, *_: seen.append((who.name, "examined"))
    )
    return seen


def test_every_task_of_every_patient_is_done_once(done, tmp_path):
    told: list[str] = []
    everyone = patients()
    side_by_side.do_ahead(everyone, PLAN, tmp_path, told.append)
    tasks = [s.name for s in PLAN.settings] + ["boundary", "kelvin_voigt"]
    tasks.append("uncertainty of eq10_auto")
    assert sorted(set(done)) == sorted(
        (who.name, task) for who in everyone for task in (*tasks, "examined")
    )
    assert sorted(one for one in done if one[1] != "examined") == sorted(
        (who.name, task) for who in everyone for task in tasks
    )
    assert {one for one in done[: len(everyone)]} == {
        (who.name, "examined") for who in everyone
    }
    assert len(told) == len(everyone) * (len(tasks) + 1)
    assert len(told) < experiment.n_stages(PLAN)


@pytest.mark.slow
def test_tasks_reach_other_processes():
    joblib = pytest.importorskip("joblib")
    who, settings = patients()[0], PLAN.settings
    with task_pool(2, "") as run:
        found = run(joblib.delayed(_arrived)(who, PLAN, one) for one in settings)
        assert sorted(found) == sorted(_arrived(who, PLAN, one) for one in settings)


def _arrived(*task):
    who, plan, setting = task
    return f"{who.digest(2.0)} {plan} {setting.as_dict()}"


def test_dask_is_asked_for_by_name(tmp_path):
    plan = replace(PLAN, dask="127.0.0.1:1")
    try:
        import distributed  # noqa: F401
    except ImportError:
        with pytest.raises(MissingPackageError, match=r"ttus-opt\[parallel\]"):
            side_by_side.do_ahead([], plan, tmp_path, str)
    else:
        with pytest.raises(InputError, match="no dask scheduler answers"):
            side_by_side.do_ahead([], plan, tmp_path, str)
    refuses(InputError, "jobs must be at least 1", replace, PLAN, jobs=0)


@pytest.mark.long
def test_tasks_run_on_a_dask_cluster(tmp_path):
    distributed = pytest.importorskip("distributed")
    joblib = pytest.importorskip("joblib")
    with (
        distributed.LocalCluster(
            n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None
        ) as cluster,
        task_pool(1, cluster.scheduler_address) as run,
    ):
        assert sorted(run(joblib.delayed(abs)(x) for x in (-3, 2))) == [2, 3]

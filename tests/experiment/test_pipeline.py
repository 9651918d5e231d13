"""The whole experiment, coarse and small: what it writes, and that it goes on."""

import contextlib
import json
import math
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.kit import FileError, InputError, MissingPackageError, refuses
from ttus_opt import experiment
from ttus_opt.experiment import patients as phantoms
from ttus_opt.experiment import pipeline
from ttus_opt.experiment.boundary import FACTORS
from ttus_opt.experiment.patients import patients
from ttus_opt.experiment.pipeline import ITSELF, _wanted
from ttus_opt.experiment.settings import compared
from ttus_opt.experiment.tables import title
from ttus_opt.fitting.path.task_pool import task_pool

PLAN = experiment.Plan(
    shape=(16, 48, 24),
    formulations=("eq10", "eq10_sign"),
    resolution=3.5,
    patients=("lean",),
    weights="auto",
    uncertainty=True,
)


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    folder, stages = tmp_path_factory.mktemp("experiment"), []
    return folder, experiment.run(folder, PLAN, progress=stages.append), stages


@pytest.mark.slow
def test_rows_are_there_for_every_setting_and_recording(done):
    _, result, stages = done
    told = {(r.setting, r.recording, r.against) for r in result.rows}
    settings = {s.name for s in PLAN.settings}
    assert len(told) == len(result.rows) == 4 * (2 * len(settings) + 1)
    assert {name for name, _, _ in told} == settings | {ITSELF}
    assert len(stages) <= experiment.n_stages(PLAN)
    assert [row.factor for row in result.boundary] == list(FACTORS)


@pytest.mark.slow
def test_measured_forces_help_and_matter_more_than_the_boundary_value(done):
    _, result, _ = done

    def error(setting, seen):
        rows = [r for r in result.rows if r.setting == setting and r.seen is seen]
        return np.mean([r.score.force_magnitude_error_N for r in rows])

    for seen in (True, False):
        assert error("paper_with", seen) < error("paper_without", seen)
        assert error("eq10", seen) < 0.5 * error("paper_without", seen)
    before = [row.before_N for row in result.boundary]
    after = [row.after_N for row in result.boundary]
    assert np.ptp(after) < 0.2 * np.ptp(before)


@pytest.mark.slow
def test_weights_are_chosen_and_told(done):
    folder, result, _ = done
    told = json.loads((folder / "lean" / "eq10_auto.json").read_text(encoding="utf-8"))
    choice = told["facts"]["weights_chosen"]
    assert choice["by"] == "places left out"
    assert choice["weights"]["force"] not in (0.0, 1.0)
    rows = [r.score for r in result.rows if r.setting == "eq10_auto" and not r.seen]
    assert len(rows) == 4
    assert "eq. 10, weights chosen" in (folder / "report.md").read_text("utf-8")


@pytest.mark.slow
def test_stated_uncertainty_is_checked_on_new_trajectories(done):
    """eq. 10 knows no drag: its noise holds the phantom's, and covers it."""
    folder, result, _ = done
    stated = {each.setting: each for each in result.patients[0].uncertainties}[
        "eq10_auto"
    ]
    assert not stated.refused
    for name in ("press_test", "sweep_test"):
        figures, curve = stated.figures[name], stated.curves[name]
        assert 0.8 < figures.force_coverage == pytest.approx(curve.coverage)
        assert figures.force_std_N > 0.0
        assert curve.force[0] < 0.3 < curve.force[10]
    text = (folder / "report.md").read_text(encoding="utf-8")
    assert "How sure the model is" in text and "figures/calibration.png" in text
    assert "lean, eq. 10, weights chosen, press" in text


@pytest.mark.slow
def test_files_hold_what_was_found_and_the_page_its_figures(done):
    folder, result, _ = done
    told = json.loads((folder / "results.json").read_text(encoding="utf-8"))
    assert len(told["rows"]) == len(result.rows)
    text = (folder / "report.md").read_text(encoding="utf-8")
    pictures = ("lean-press", "lean-sweep", "lean-slice", "boundary", "calibration")
    for name in pictures:
        assert f"figures/{name}.png" in text
        assert (folder / "figures" / f"{name}.png").stat().st_size < 150_000
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert page.count("data:image/png;base64,") == 5
    assert 'src="figures' not in page
    score = next(r.score for r in result.rows if r.setting == "eq10" and not r.seen)
    assert f"{score.force_magnitude_error_N:.2f}" in text


@pytest.mark.slow
def test_a_second_call_computes_nothing_again(done, monkeypatch):
    folder, result, _ = done

    def forbidden(*_, **__):
        raise AssertionError("computed again")

    monkeypatch.setattr("ttus_opt.experiment.patients.skin_compliance", forbidden)
    monkeypatch.setattr("ttus_opt.experiment.fits.fit", forbidden)
    monkeypatch.setattr("ttus_opt.experiment.boundary.fit", forbidden)
    again = experiment.run(folder, PLAN)
    assert repr(again.rows) == repr(result.rows)
    other = experiment.Plan(PLAN.shape, ("eq10",), 2.0, 3.5, patients=("lean",))
    refuses(AssertionError, "computed again", experiment.run, folder, other)


def test_missing_finite_elements_are_told_by_name(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "skfem", None)
    with pytest.raises(MissingPackageError, match=r"skfem.*ttus-opt\[phantom\]"):
        phantoms.examine(patients()[0], tmp_path, 4.0)
    assert not (tmp_path / "digest.txt").exists()


def test_weights_are_for_formulations_that_do_not_choose_their_own():
    eq10, depth, drag = compared(("eq10", "depth_map", "coulomb_global"), 0.3)
    assert dict(eq10.options) == {"force_weight": 0.3, "torque_weight": 0.3}
    assert dict(drag.options) == dict(eq10.options)
    assert dict(depth.options) == {}
    refuses(InputError, "twice", compared, ("eq10", "eq10"), 1.0)
    refuses(InputError, "eq99", compared, ("eq99",), 1.0)


def test_weights_from_the_recordings_stand_beside_the_given_ones():
    plan = experiment.Plan(formulations=("eq10", "depth_map"), weights="auto")
    given = experiment.Plan(formulations=("eq10", "depth_map"))
    more = plan.settings[len(given.settings) :]
    assert plan.settings[: len(given.settings)] == given.settings
    assert [(s.name, s.weights) for s in more] == [("eq10_auto", "auto")]
    assert "chooses" not in given.settings[0].as_dict()
    assert more[0].as_dict()["chooses"] and not more[0].options
    assert title("eq10_auto") == "eq. 10, weights chosen"
    with pytest.raises(InputError, match=r"evidence.*: take given, auto or default"):
        experiment.Plan(weights="evidence")
    default = experiment.Plan(formulations=("eq10", "depth_map"), weights="default")
    *same, last = default.settings
    assert tuple(same) == plan.settings and last.formulation is None
    assert last.as_dict()["chooses"] == "default" and title(last.name) == "default"


def test_the_default_on_refined_poses_stands_beside_it():
    plan = experiment.Plan(formulations=("eq10",), weights="default", refine=True)
    *_, plain, refined = plan.settings
    assert (plain.formulation, refined.formulation) == (None, None)
    assert "refined" not in plain.as_dict() and refined.as_dict()["refined"]
    assert title(refined.name) == "default, poses refined"


def test_refuses_plans_that_cannot_be_done(tmp_path):
    for wrong in ({"weight": 0.0}, {"weight": math.nan}, {"resolution": 0.0}):
        refuses(InputError, "needs a weight above 0", experiment.Plan, **wrong)
    assert [experiment.Plan(resolution=r).resolution for r in (0.3, 10.0)] == [
        0.3,
        10.0,
    ]
    with pytest.raises(InputError, match="choose from lean, stout, average"):
        experiment.run(tmp_path, experiment.Plan(patients=("fat",)))
    assert not list(tmp_path.iterdir())


def test_a_file_named_like_something_else_that_is_kept_is_refused(tmp_path):
    words = "def build(scene, force_weight=1.0):\n    pass\n"
    for name in ("eq10", "laplace_scaled", "surface", "boundary", "depth_map_auto"):
        (tmp_path / f"{name}.py").write_text(words)
    for name in ("eq10", "laplace_scaled", "surface", "boundary"):
        plan = experiment.Plan(formulations=(str(tmp_path / f"{name}.py"),))
        refuses(
            InputError, f"in the folder, {name}: rename it", getattr, plan, "settings"
        )
    (tmp_path / "mine.py").write_text(words)
    (tmp_path / "mine_auto.py").write_text(words)
    both = (str(tmp_path / "mine.py"), str(tmp_path / "mine_auto.py"))
    assert len(experiment.Plan(formulations=both).settings) == 7
    with pytest.raises(InputError, match="mine_auto"):
        experiment.Plan(formulations=both, weights="auto").settings  # noqa: B018


def test_what_stands_in_the_way_is_told_before_the_work(tmp_path, monkeypatch):
    begun = []

    def work(patient, *_):
        begun.append(patient.name)
        raise KeyboardInterrupt

    monkeypatch.setattr("ttus_opt.experiment.pipeline._on_patient", work)
    for name in ("lean", "figures"):
        folder = tmp_path / name
        folder.mkdir()
        (folder / name).touch()
        refuses(FileError, f"{name} is not a folder", experiment.run, folder)
    folder = tmp_path / "report"
    (folder / "report.html").mkdir(parents=True)
    refuses(FileError, r"report\.html: it is a folder", experiment.run, folder)
    torso = tmp_path / "torso.ply"
    torso.touch()
    for patient in ("nobody", "average"):
        plan = experiment.Plan(patients=(patient,), torso=torso)
        with pytest.raises(InputError, match="choose from lean, stout, scanned"):
            experiment.run(tmp_path / "new", plan)
    assert not begun and not (tmp_path / "new").exists()
    with pytest.raises(KeyboardInterrupt):
        experiment.run(tmp_path / "new", experiment.Plan(patients=("stout",)))
    assert begun == ["stout"]


def test_a_patient_named_twice_is_examined_once_and_the_order_is_kept():
    plan = experiment.Plan(patients=("stout", "lean", "stout"))
    assert _wanted(plan) == ("stout", "lean")
    assert _wanted(experiment.Plan()) == ("lean", "stout", "average")


PARALLEL = experiment.Plan(
    (16, 48, 24),
    ("eq10",),
    comparators=("kelvin_voigt",),
    jobs=2,
    weights="auto",
    uncertainty=True,
)


@pytest.fixture
def finished(monkeypatch):
    """What is finished, by threads, that share this list; nothing is computed."""
    joblib = pytest.importorskip("joblib")
    seen: list[tuple[str, str]] = []

    class Fits:
        stamp = ""

        def __init__(self, examination, folder, *_):
            self.folder = folder

        def fitted(self, setting):
            seen.append((self.folder.name, setting.name))

        def rival(self, name):
            seen.append((self.folder.name, name))

    @contextlib.contextmanager
    def threads(jobs, address):
        yield joblib.Parallel(jobs, "threading", return_as="generator_unordered")

    def noted(name):
        return lambda fits, *_: seen.append((fits.folder.name, name))

    monkeypatch.setattr(pipeline, "task_pool", threads)
    monkeypatch.setattr(pipeline, "PatientFits", Fits)
    monkeypatch.setattr(pipeline, "boundary_errors", noted("boundary"))
    monkeypatch.setattr(
        pipeline,
        "stated_uncertainty",
        lambda fits, setting, *_: noted(f"uncertainty of {setting.name}")(fits),
    )
    monkeypatch.setattr(
        pipeline, "examine", lambda who, *_: seen.append((who.name, "examined"))
    )
    return seen


def test_every_task_of_every_patient_is_done_once(finished, tmp_path):
    told: list[str] = []
    everyone = patients()
    pipeline.do_ahead(everyone, PARALLEL, tmp_path, told.append)
    tasks = [s.name for s in PARALLEL.settings] + ["boundary", "kelvin_voigt"]
    tasks.append("uncertainty of eq10_auto")
    assert sorted(set(finished)) == sorted(
        (who.name, task) for who in everyone for task in (*tasks, "examined")
    )
    assert sorted(one for one in finished if one[1] != "examined") == sorted(
        (who.name, task) for who in everyone for task in tasks
    )
    assert {one for one in finished[: len(everyone)]} == {
        (who.name, "examined") for who in everyone
    }
    assert len(told) == len(everyone) * (len(tasks) + 1)
    assert len(told) < experiment.n_stages(PARALLEL)


@pytest.mark.slow
def test_tasks_reach_other_processes():
    joblib = pytest.importorskip("joblib")
    who, settings = patients()[0], PARALLEL.settings
    with task_pool(2, "") as run:
        found = run(joblib.delayed(_arrived)(who, PARALLEL, one) for one in settings)
        assert sorted(found) == sorted(_arrived(who, PARALLEL, one) for one in settings)


def _arrived(*task):
    who, plan, setting = task
    return f"{who.digest(2.0)} {plan} {setting.as_dict()}"


def test_dask_is_asked_for_by_name(tmp_path):
    plan = replace(PARALLEL, dask="127.0.0.1:1")
    try:
        import distributed  # noqa: F401
    except ImportError:
        with pytest.raises(MissingPackageError, match=r"ttus-opt\[parallel\]"):
            pipeline.do_ahead([], plan, tmp_path, str)
    else:
        with pytest.raises(InputError, match="no dask scheduler answers"):
            pipeline.do_ahead([], plan, tmp_path, str)
    refuses(InputError, "jobs must be at least 1", replace, PARALLEL, jobs=0)


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

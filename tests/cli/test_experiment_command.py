"""What ``ttus-opt experiment`` refuses and says; the work is tested below it."""

from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import empty, refused
from ttus_opt import experiment
from ttus_opt.experiment import pipeline
from ttus_opt.experiment.pipeline import ExperimentResult


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("--shape 10,20", "--shape takes 3 numbers"),
        ("--shape 3,20,20", "n_r must be a whole number of at least 4"),
        ("--shape 1e308,20,20", "at most 1,000,000, got 1000"),
        ("--shape 99999,99999,9999", "choose a smaller shape"),
        ("--weight 1e300", "at most 1e+15"),
        ("--formulations eq99", "eq99"),
        ("--formulations eq10,eq10", "named twice"),
        ("--weight 0", "weight above 0"),
        ("--patients nobody", "choose from lean, stout, average"),
        ("--torso none.ply", "none.ply"),
        ("--shape 4,4,4", "shape (4, 4, 4) is too coarse for stout"),
        ("--resolution coarse", "resolution"),
        ("--comparators nobody", "choose from"),
    ],
)
def test_refuses_in_one_line(run, output, words, said):
    refused(run(f"experiment {words} -o {output}"), said)
    assert empty(output)


def test_the_scans_unit_is_told_by_its_own_option(run, files, output):
    scan = 1e3 * np.load(files / "scan.npy")
    np.save(output / "mm.npy", scan)
    words = f"experiment --torso {output / 'mm.npy'} --torso-unit m -o {output / 'r'}"
    refused(run(words), "millimetres? pass --torso-unit mm")
    assert not (output / "r").exists()


def test_a_folder_that_cannot_be_is_told_before_the_work(run, output, monkeypatch):
    def work(*given):
        pytest.fail("it has begun")

    monkeypatch.setattr(pipeline, "_on_patient", work)
    (output / "file").write_text("kept")
    for folder in ("file", "file/results"):
        refused(run(f"experiment -o {output / folder}"), "file is not a folder")
    refused(
        run(f"experiment -o {output / ('x' * 300)}"), "cannot write", "too long: choose"
    )
    assert [path.name for path in output.iterdir()] == ["file"]


def test_options_reach_the_plan(run, output, monkeypatch):
    seen = []

    def planned(folder, plan, progress):
        seen.append((folder, plan))
        return ExperimentResult(plan, ())

    monkeypatch.setattr(experiment, "run", planned)
    told = run(
        f"experiment --shape 24,72,30 --formulations eq10,depth_map --weight 0.5 "
        f"--torso t.ply --torso-unit m --patients lean,stout --resolution 2 "
        f"--json -o {output}"
    ).told
    ((folder, plan),) = seen
    assert (folder, plan.torso, plan.torso_unit) == (output, Path("t.ply"), "m")
    assert plan.shape == (24, 72, 30) and plan.formulations == ("eq10", "depth_map")
    assert (plan.weight, plan.resolution) == (0.5, 2.0)
    assert plan.patients == ("lean", "stout") and plan.comparators == ()
    assert told["rows"] == [] and told["shape"] == [24, 72, 30]

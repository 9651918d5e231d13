"""What a run tells its parent, in the order of its stages."""

import json

import numpy as np

from ttus_opt.benchmark.progress import KEPT, RESIDUAL, STAGES, Progress


def test_stages_are_told_as_they_begin_and_measured_as_they_end(tmp_path):
    progress = Progress(tmp_path)
    for stage in ("scene", "first", "scene"):
        progress(stage)
        np.ones(10)
    assert set(progress.peaks) == {"scene", "first"}  # the last has not ended
    progress.end()
    progress.end()  # nothing runs any more
    lines = (tmp_path / STAGES).read_text().splitlines()
    told = [json.loads(line) for line in lines]
    assert [line["stage"] for line in told] == ["scene", "first", "scene"]
    assert told[0]["time"] <= told[1]["time"] <= told[2]["time"]
    assert all(peak > 2**20 for peak in progress.peaks.values())


def test_the_last_residual_stands(tmp_path):
    progress = Progress(tmp_path)
    for residual in (1e-2, 1.0 / 3.0):
        progress.reached(residual)
    assert float((tmp_path / RESIDUAL).read_text()) == 1.0 / 3.0


def test_what_is_kept_may_lie_in_a_folder_of_its_own(tmp_path):
    path = Progress(tmp_path).keep("profiles/eq10.txt")
    path.write_text("a profile")
    assert (tmp_path / KEPT / "profiles" / "eq10.txt").read_text() == "a profile"

"""The recursive fit is timed on what it should hold, and equals the batch fit."""

from dataclasses import replace

import pytest

from tests.benchmark.parts.quick import QUICK, TINY, measured
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts import recursion
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.benchmark.row import MEASURED, Settings


@pytest.mark.slow
def test_recursion_equals_the_batch_fit(tmp_path):
    (row,) = measured(parts()["recursion"], tmp_path)
    assert row["held"] == 30
    assert row["difference_from_batch"] < 1e-8
    assert row["difference_from_batch"] < 1e-4 * row["change_from_prior"]


@pytest.mark.slow
def test_recursion_takes_poses_again_until_there_are_enough():
    scene = replace(TINY, n_poses=40).scene()
    own = int((scene.rows.contact_points > 0).sum())
    assert own < 100
    found = recursion._touching(scene, 100)
    assert len(found) == 100
    rows = recursion.with_measurements(scene, found).rows
    assert (rows.contact_points > 0).all()


@pytest.mark.slow
def test_recursion_out_of_time_says_how_far_it_came(tmp_path):
    part = parts()["recursion"]
    (spec,) = part.plan([TINY], Settings(time_limit=1e-9))
    asked = replace(spec, options=QUICK["recursion"])
    (row,) = part.measure(asked, Progress(tmp_path))
    assert row["held"] == 1
    assert row["detail"] == "stopped after 1 of 30 updates by the time limit"
    whole = {"case": "tiny", "status": MEASURED} | row
    assert "stopped after 1 of 30" in str(part.table([whole]))

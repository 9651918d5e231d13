"""Gaps, repeated rows and wrong descriptions: each is bridged, or named."""

import numpy as np
import pytest

from tests.session.recordings import copied, described
from ttus_opt.core.errors import InputError, TtusWarning
from ttus_opt.probe.trajectory import Trajectory, read_trajectory
from ttus_opt.sensors.netcdf_stream import write_netcdf_wrenches
from ttus_opt.sensors.stream_files import read_wrenches
from ttus_opt.sensors.streams import WrenchStream
from ttus_opt.session import pipeline
from ttus_opt.session.pipeline import run_session

# a recording this short, on so coarse a grid, does not bear weights of its own
pytestmark = pytest.mark.filterwarnings(
    "ignore:weights were not chosen:ttus_opt.core.errors.TtusWarning"
)


def begins(recording):
    """When the first stretch to fit to begins [s]."""
    return float(described(recording)["recordings"]["press_fit"]["from"])


def without(recording, stream, lost):
    """Take rows out of the tracker's or the sensor's file, by their times."""
    if stream == "tracker":
        poses = read_trajectory(recording / "tracker.csv")
        poses.select(~lost(poses.time)).save(recording / "tracker.csv")
        return
    read = read_wrenches(recording / "force.nc")
    kept = ~lost(read.time)
    kept = WrenchStream(read.time[kept], read.force[kept], read.torque[kept])
    write_netcdf_wrenches(kept, recording / "force.nc")


@pytest.mark.parametrize(
    ("stream", "gap"),
    [
        ("tracker", 0.25),
        *(
            pytest.param(stream, gap, marks=pytest.mark.slow)
            for stream, gap in (
                ("tracker", 0.05),
                ("force", 0.05),
                ("force", 0.25),
                ("tracker", 3.0),
                ("force", 3.0),
            )
        ),
    ],
)
def test_gaps_are_bridged_by_nothing(tmp_path, monkeypatch, stream, gap):
    fitted: list[Trajectory] = []

    def fit(_session, _surface, _shell, recordings):
        fitted.append(recordings["press_fit"])
        raise InputError("far enough")

    monkeypatch.setattr(pipeline, "fit_model", fit)
    recording = copied(tmp_path)
    start = begins(recording) + 0.4
    without(recording, stream, lambda time: (time >= start) & (time < start + gap))
    with pytest.raises(InputError, match="far enough"):
        run_session(recording, tmp_path / "out")
    assert len(np.unique(fitted[0].segment)) == 1 + (gap > 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("stream", ["tracker", "force"])
def test_a_lost_stretch_and_lost_rows(tmp_path, stream):
    recording = copied(tmp_path)
    rng = np.random.default_rng(0)
    without(recording, stream, lambda time: rng.random(len(time)) < 0.2)
    found = run_session(recording, tmp_path / "out")
    assert len(found.recordings["press_fit"]) > 100
    start = begins(recording) - 1.0
    without(recording, stream, lambda time: (time > start) & (time < start + 9.0))
    with pytest.raises(InputError, match="recordings: press_fit has 0 frames"):
        run_session(recording, tmp_path / "out")


def test_repeated_rows_are_left_out(tmp_path):
    recording = copied(tmp_path)
    head, *rows = (recording / "tracker.csv").read_text().splitlines()
    twice = [row for i, row in enumerate(rows) for row in [row] * (1 + (i % 9 == 0))]
    (recording / "tracker.csv").write_text("\n".join([head, *twice, ""]))
    with pytest.warns(TtusWarning, match="equal to the row before"):
        poses = read_trajectory(recording / "tracker.csv")
    assert len(poses) == len(rows)
    rows[3] = ",".join([rows[2].split(",")[0], *rows[3].split(",")[1:]])
    (recording / "tracker.csv").write_text("\n".join([head, *rows, ""]))
    with pytest.raises(OSError, match="repeats"):  # other numbers at the same time
        read_trajectory(recording / "tracker.csv")


def jumped(recording):
    poses = read_trajectory(recording / "tracker.csv")
    late = (poses.time > begins(recording) + 2.0)[:, None]
    position = poses.position + late * [0.05, 0.0, 0.0]
    Trajectory(poses.time, position, poses.rotation).save(recording / "tracker.csv")

"""A recording from end to end: what it finds, what it writes, what it leaves.

Gaps, repeated rows and wrong descriptions: each is bridged, or named.
"""

import json

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import FileError, InputError, TtusWarning, refuses
from tests.session.recordings import (
    SECONDS,
    begins,
    calibrated,
    changed,
    copied,
    described,
    made,
)
from ttus_opt.phantom.example_data import frame
from ttus_opt.probe.rigid_motion import inverse
from ttus_opt.sensors.netcdf_stream import write_netcdf_wrenches
from ttus_opt.sensors.stream_files import read_wrenches
from ttus_opt.sensors.streams import WrenchStream
from ttus_opt.session import pipeline
from ttus_opt.session.model import fit_model, judge
from ttus_opt.session.results import STEPS, complete_steps
from ttus_opt.session.synthetic import Truth, perfect, write_recording

# a recording this short, on so coarse a grid, does not bear weights of its own
pytestmark = pytest.mark.filterwarnings(
    "ignore:weights were not chosen:ttus_opt.core.errors.TtusWarning"
)


def forces_unseen(result):
    """Mean magnitude error on motion that was not fitted [N]."""
    errors = [c.after.errors for c in result.comparisons if not c.seen]
    return float(np.mean([e.force_magnitude_error_N for e in errors]))


def forces_perfect(result, seconds):
    """The same where clocks, frames and the sensor's load are known exactly."""
    back = inverse(frame().scan_to_patient)
    own = result.skin.surface.axis.scan_to_patient
    recordings = {k: v.transformed(back, own) for k, v in calibrated(seconds).items()}
    shell = tt.PointShell.from_spec(result.session.probe)
    model = fit_model(result.session, result.skin.surface, shell, recordings)
    fields = model.before.field, model.after.field
    found = judge(fields, shell, recordings, result.session.fitted)
    errors = [c.after.errors for c in found if not c.seen]
    return float(np.mean([e.force_magnitude_error_N for e in errors]))


def check_found(result, truth):
    """Each step against the truth."""
    assert result.timing.offset == pytest.approx(truth.offset, abs=0.003)
    load = result.load
    assert load.mass == pytest.approx(truth.mass, abs=0.002)
    np.testing.assert_allclose(load.centre, truth.centre, atol=1e-3)
    np.testing.assert_allclose(load.force_bias, truth.force_bias, atol=0.08)
    belly = frame().to_scan(np.array([[0.0, 0.12, 0.15]]))[0]
    found = result.registration.tracker_to_scan
    moved = found @ inverse(truth.tracker_to_scan)
    gap = moved[:3, :3] @ belly + moved[:3, 3] - belly
    assert np.linalg.norm(gap) < 1e-3
    # the probe's path in the patient, carried back to the truth's frame
    for name, own in perfect(SECONDS).items():
        seen = result.recordings[name].transformed(
            inverse(result.registration.scan_to_patient), frame().scan_to_patient
        )
        assert np.abs(seen.position.mean(0) - own.position.mean(0)).max() < 1.5e-3
        assert np.abs(seen.force.mean(0) - own.force.mean(0)).max() < 0.15


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    """On a coarse grid and of short recordings."""
    output = tmp_path_factory.mktemp("session") / "results"
    return tt.run_session(made(), output)


@pytest.mark.slow
def test_what_it_finds(result):
    check_found(result, Truth())
    assert forces_unseen(result) < 1.2 * forces_perfect(result, SECONDS)


@pytest.mark.slow
def test_what_it_writes(result):
    folder = result.folder
    told = json.loads((folder / "session.json").read_text())
    assert told["complete"] == list(STEPS) == complete_steps(folder)
    assert told["clock"]["offset_s"] == result.timing.offset
    errors = {row["recording"]: row for row in told["evaluation"]["errors"]}
    assert errors["press_test"]["after"]["force_magnitude_error_N"] > 0.0
    for name, recording in result.recordings.items():
        written = tt.read_trajectory(folder / "recordings" / f"{name}.csv")
        np.testing.assert_array_equal(written.position, recording.position)
    field = tt.PotentialField.load(folder / "field.nc")
    shell = tt.PointShell.from_spec(result.session.probe)
    again = tt.evaluate(field, shell, result.recordings["press_test"]).errors
    first = next(c for c in result.comparisons if c.recording == "press_test")
    assert again.force_magnitude_error_N == pytest.approx(
        first.after.errors.force_magnitude_error_N
    )
    report = (folder / "report.md").read_text()
    assert f"forces moved by {result.timing.offset:.4f} s (by gravity" in report
    for line in report.splitlines():
        if line.startswith("!["):
            assert (folder / line.rpartition("(")[2].rstrip(")")).is_file()
    assert "data:image/png" in (folder / "report.html").read_text()
    assert not [f for f in folder.rglob(".*")]  # nothing half-written


@pytest.mark.slow
def test_a_second_session_replaces_the_first(result, tmp_path):
    """And one that fails leaves complete steps alone, never old ones beside new."""
    recording, output = copied(tmp_path), tmp_path / "out"
    changed(recording, "fit.formulation", "laplace_only")
    tt.run_session(recording, output)
    (output / "note.txt").write_text("the user's")
    changed(recording, "clock", {"by": "gravity", "largest_offset": 0.2})
    told = r"^clock: .*\(complete in .*out: surface, registration\)$"
    refuses(InputError, told, tt.run_session, recording, output)
    assert complete_steps(output) == ["surface", "registration"]
    left = {str(f.relative_to(output)) for f in output.rglob("*") if f.is_file()}
    assert left == {"surface.nc", "session.json", "note.txt"}


def test_nothing_is_written_where_nothing_is_to_be(tmp_path):
    recording = copied(tmp_path)
    refuses(FileError, "holds the recording", tt.run_session, recording, recording)
    other = tmp_path / "other"
    other.mkdir()
    (other / "surface.nc").write_text("unrelated files")
    refuses(FileError, "unrelated files", tt.run_session, recording, other)
    changed(recording, "tracker.file", "none.csv")
    refuses(FileError, "which is not in", tt.run_session, recording, tmp_path / "out")
    assert not (tmp_path / "out").exists()


def test_the_recording_goes_into_a_folder_of_its_own(tmp_path):
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(FileError, match="holds other files, for instance thesis"):
        write_recording(tmp_path)
    assert described(made())["title"] == "Synthetic recording"


def without(recording, stream, lost):
    """Take rows out of the tracker's or the sensor's file, by their times."""
    if stream == "tracker":
        poses = tt.read_trajectory(recording / "tracker.csv")
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
    fitted: list[tt.Trajectory] = []

    def fit(_session, _surface, _shell, recordings):
        fitted.append(recordings["press_fit"])
        raise InputError("far enough")

    monkeypatch.setattr(pipeline, "fit_model", fit)
    recording = copied(tmp_path)
    start = begins(recording) + 0.4
    without(recording, stream, lambda time: (time >= start) & (time < start + gap))
    refuses(InputError, "far enough", tt.run_session, recording, tmp_path / "out")
    assert len(np.unique(fitted[0].segment)) == 1 + (gap > 0.1)


@pytest.mark.slow
@pytest.mark.parametrize("stream", ["tracker", "force"])
def test_a_lost_stretch_and_lost_rows(tmp_path, stream):
    recording = copied(tmp_path)
    rng = np.random.default_rng(0)
    without(recording, stream, lambda time: rng.random(len(time)) < 0.2)
    found = tt.run_session(recording, tmp_path / "out")
    assert len(found.recordings["press_fit"]) > 100
    start = begins(recording) - 1.0
    without(recording, stream, lambda time: (time > start) & (time < start + 9.0))
    with pytest.raises(InputError, match="recordings: press_fit has 0 frames"):
        tt.run_session(recording, tmp_path / "out")


def test_repeated_rows_are_left_out(tmp_path):
    recording = copied(tmp_path)
    head, *rows = (recording / "tracker.csv").read_text().splitlines()
    twice = [row for i, row in enumerate(rows) for row in [row] * (1 + (i % 9 == 0))]
    (recording / "tracker.csv").write_text("\n".join([head, *twice, ""]))
    with pytest.warns(TtusWarning, match="equal to the row before"):
        poses = tt.read_trajectory(recording / "tracker.csv")
    assert len(poses) == len(rows)
    rows[3] = ",".join([rows[2].split(",")[0], *rows[3].split(",")[1:]])
    (recording / "tracker.csv").write_text("\n".join([head, *rows, ""]))
    with pytest.raises(OSError, match="repeats"):  # other numbers at the same time
        tt.read_trajectory(recording / "tracker.csv")

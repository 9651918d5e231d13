"""``ttus-opt example``: a folder to try the commands in."""

import hashlib

import numpy as np
import pytest

import ttus_opt as tt
from tests.cli.conftest import refused
from tests.kit import FileError, refuses
from ttus_opt import example
from ttus_opt.sensors.stream_files import read_poses
from ttus_opt.session.example_folder import FILES, FORCE_OFFSET, write_folder


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return write_folder(tmp_path_factory.mktemp("example") / "try")


def contents(folder):
    files = (f for f in sorted(folder.rglob("*")) if f.suffix not in ("", ".nc"))
    return {f.name: hashlib.sha256(f.read_bytes()).hexdigest() for f in files}


def test_what_is_written_is_what_is_listed_and_small(folder):
    assert {f.name for f in folder.iterdir()} == set(FILES)
    assert sum(f.stat().st_size for f in folder.rglob("*") if f.is_file()) < 4e6


@pytest.mark.slow
def test_it_comes_out_the_same_every_time(folder, tmp_path):
    assert contents(write_folder(tmp_path / "again")) == contents(folder)


def test_nothing_is_overwritten_without_being_told(run, tmp_path, monkeypatch):
    own = tmp_path / "press.csv"
    own.write_text("mine")
    refuses(FileError, "has press.csv already", write_folder, tmp_path)
    refused(run(f"example {tmp_path}"), "press.csv", "--force")
    assert own.read_text() == "mine" and len(list(tmp_path.iterdir())) == 1

    def stopped(place):
        (place / "press.csv").write_text("half")
        raise OSError("disk full")

    monkeypatch.setattr("ttus_opt.session.example_folder._write", stopped)
    refused(run(f"example {tmp_path} --force"), "disk full")
    assert own.read_text() == "mine" and len(list(tmp_path.iterdir())) == 1


def test_the_command_lists_the_files(run, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "ttus_opt.session.example_folder.write_folder", lambda *_, **__: None
    )
    lines = run(f"example {tmp_path}").out.splitlines()
    assert [line.split()[0] for line in lines[: len(FILES)]] == list(FILES)
    assert max(map(len, lines[: len(FILES)])) <= 80
    assert run(f"example {tmp_path} --json").told["files"] == FILES


def test_recordings_lie_on_the_skin_that_the_scan_shows(folder):
    """By the bundled true surface, which the scan's own frame knows nothing of."""
    frame = tt.Axis.from_cloud(tt.read_cloud(folder / "scan.ply", unit="mm"))
    truth = tt.Surface.load(example.path("surface.nc"))
    stated = np.loadtxt(folder / "base_to_scan.txt")
    to_scan = np.linalg.inv(frame.scan_to_patient)
    known = tt.read_trajectory(example.path("press_fit.csv"))
    in_patient = tt.read_trajectory(folder / "press.csv").transformed(
        to_scan, truth.axis.scan_to_patient
    )
    robot = tt.read_trajectory(folder / "robot.csv")
    in_base = robot.transformed(stated, truth.axis.scan_to_patient)
    for found in (in_patient, in_base):
        assert found.position == pytest.approx(known.position, abs=1e-6)
        assert found.rotation == pytest.approx(known.rotation, abs=1e-6)
    assert in_patient.force == pytest.approx(known.force, abs=1e-6)
    # of the tool on the patient, in the tool's axes
    force = -np.einsum("tij,tj->ti", known.rotation, robot.force)
    assert force == pytest.approx(known.force, abs=1e-6)


def test_the_other_clock_is_behind(folder):
    pushes = tt.read_trajectory(folder / "press.csv")
    rows = np.loadtxt(folder / "force.csv", delimiter=",", skiprows=1)
    at = np.interp(
        rows[:, 0] + FORCE_OFFSET, pushes.time, np.linalg.norm(pushes.force, axis=1)
    )
    assert np.abs(np.linalg.norm(rows[:, 1:4], axis=1) - at).mean() < 0.05
    assert len(read_poses(folder / "tracker.csv")) == 798

"""``-`` for stdin and stdout, and what is said beside it."""

import io
import sys

import numpy as np
import pytest

from tests.cli.conftest import refused
from ttus_opt.cli.standard_streams import _kept
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.streams import WrenchStream


@pytest.fixture
def recorded(tmp_path):
    """Poses and wrenches of ten frames."""
    time = 0.05 * np.arange(10.0)
    turns = np.tile(np.eye(3), (10, 1, 1))
    Trajectory(time, np.outer(time, [0, 0, 0.01]), turns).save(tmp_path / "poses.csv")
    WrenchStream(time, np.outer(time, [1.0, 2.0, 3.0])).save(tmp_path / "force.csv")
    return tmp_path


def typed(monkeypatch, content):
    """Stdin with this content."""
    stdin = io.TextIOWrapper(io.BytesIO(content))
    monkeypatch.setattr(sys, "stdin", stdin)


def words(poses="-", output="-", wrenches="{}/force.csv"):
    return f"synchronise {poses} --wrenches {wrenches} --offset 0 -o {output}"


def test_a_result_on_stdout_is_the_file_and_words_go_beside_it(
    run, recorded, monkeypatch
):
    poses = recorded / "poses.csv"
    out = recorded / "out.csv"
    wrenches = recorded / "force.csv"
    told = run(words(poses, out, wrenches))
    assert told.out.startswith(f"{out}: 10 of 10 frames")
    typed(monkeypatch, poses.read_bytes())
    answer = run(words(wrenches=wrenches))
    assert answer.status == 0
    assert answer.out == out.read_text()
    assert answer.errors == [told.out.strip().replace(str(out), "stdout")]


def test_an_error_names_stdin_and_no_file_that_is_gone(run, recorded, monkeypatch):
    typed(monkeypatch, b"")
    answer = run(words(wrenches=recorded / "force.csv"))
    refused(answer, "stdin.csv is empty")
    assert "ttus-opt-" not in answer.errors[0]


def test_what_cannot_be_a_stream_is_refused(run, recorded):
    wrenches = recorded / "force.csv"
    refused(run(words(wrenches="-")), "read once")
    refused(run(words(recorded / "poses.csv", "-", wrenches) + " --json"), "both write")
    refused(run("demo -o -"), "is a folder")
    refused(run("experiment -o -"), "is a folder")
    surface = "fit --surface s.nc --probe sphere:0.02 --trajectory a.csv -o f.nc"
    refused(run(f"{surface} --picture -"), "name a file for --picture")
    fitted = "--probe sphere:0.02 -o r.csv"
    flat = f"render --field f.nc {fitted} --trajectory a.csv --flat -"
    refused(run(flat), "name a file for --flat")
    refused(run("record localhost --poses -"), "name a file for --poses")
    sensor = "--axes x,y,z --point 0,0,0 --sign probe --down 0,0,-1"
    model = f"compensate a.csv --free b.csv {sensor} {fitted} --model -"
    refused(run(model), "name a file for --model")
    two = surface.replace("a.csv", "- --trajectory b.csv")
    refused(run(two), "read once")


@pytest.mark.parametrize(
    ("content", "name"),
    [
        (b"t,px\n", "stdin.csv"),
        (b"ply\nformat", "stdin.ply"),
        (b"# .PCD v0.7", "stdin.pcd"),
        (b"\x89HDF\r\n", "stdin.nc"),
        (b'{"K": []}', "stdin.json"),
    ],
)
def test_stdin_is_kept_as_what_it_holds(monkeypatch, tmp_path, content, name):
    typed(monkeypatch, content)
    kept = _kept(tmp_path)
    assert kept.name == name and kept.read_bytes() == content


def test_a_log_says_what_is_done_and_quiet_leaves_the_result(run, recorded):
    poses, out = recorded / "poses.csv", recorded / "out.csv"
    plain = words(poses, out, recorded / "force.csv")
    usual = run(plain)
    told = run(f"{plain} -v")
    assert told.out == usual.out and usual.errors == []
    assert [line.partition(" s  ")[2] for line in told.errors][-1] == (
        f"core.io: wrote {out}, {out.stat().st_size} bytes"
    )
    more = run(f"{plain} -vv").errors
    assert len(more) > len(told.errors) and any("reads" in line for line in more)
    for again in (f"{plain} --quiet", plain):  # nothing is left of -v
        told = run(again)
        assert (told.out, told.errors) == (usual.out, [])


def test_no_bar_where_quiet(capsys):
    from ttus_opt.cli import console

    for quiet in (True, False):
        with console.speaking(0, quiet=quiet, json=False), console.Stages(1) as begin:
            begin("work")
            assert begin._thread.is_alive() is not quiet

"""``ttus-opt session`` and ``ttus-opt record``."""

import json
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.cli.conftest import empty, refused
from tests.kit import some
from tests.session.recordings import changed, copied, jumped
from ttus_opt.sensors.netcdf_stream import write_netcdf_wrenches
from ttus_opt.sensors.stream_files import read_wrenches
from ttus_opt.sensors.streams import WrenchStream
from ttus_opt.session.results import STEPS


@pytest.mark.slow
def test_a_session(run, tmp_path, output):
    recording = copied(tmp_path)
    answer = run(f"session {recording} -o {output} --json")
    assert answer.status == 0, answer.err
    # a recording this short does not bear weights of its own, which is told
    assert all("weights were not chosen" in line for line in answer.errors)
    told = json.loads(answer.out)
    assert told["complete"] == list(STEPS)
    assert told["clock"]["offset_s"] == pytest.approx(0.83, abs=0.003)
    assert Path(told["report"]).read_text().startswith("# Synthetic recording")


def test_what_is_refused(run, tmp_path, output):
    recording = copied(tmp_path)
    refused(run(f"session {recording}"), "--output")
    refused(run(f"session {tmp_path} -o {output}"), "session.yaml", "ttus-opt example")
    changed(recording, "tracker.frame", "robot")
    words = ("session.json: tracker.frame must be tracker or scan or patient",)
    refused(run(f"session {recording} -o {output}"), *words)
    (recording / "mine.py").write_text(f"open({str(output / 'executed')!r}, 'w')")
    changed(recording, "fit.formulation", "mine.py")
    changed(recording, "tracker.frame", "tracker")
    refused(run(f"session {recording} -o {output}"), "mine.py", "--trust")
    changed(recording, "fit.formulation", None)
    (recording / "depth_1.png").write_bytes(b"no picture")
    changed(recording, "tracker.frame", "tracker")
    refused(run(f"session {recording} -o {output}"), "error: surface: ", "depth_1.png")
    assert empty(output)


@pytest.mark.slow
def test_an_interrupt_says_what_is_complete(run, tmp_path, output, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    recording = copied(tmp_path)
    monkeypatch.setattr("ttus_opt.session.pipeline.synchronise", stop)
    answer = run(f"session {recording} -o {output}")
    assert answer.status == 130
    assert answer.errors[0] == f"complete in {output}: surface, registration"
    assert {f.name for f in output.iterdir()} == {"session.json", "surface.nc"}


def test_a_recording_of_openigtlink(run, output):
    pytest.importorskip("pyigtl", reason="needs pyigtl, which sends")
    from tests.sensors.test_open_igt_link import at_once, sensor, serving, transform
    from ttus_opt.probe.trajectory import read_trajectory

    poses, forces = output / "poses.csv", output / "forces.csv"
    sent = [m for i in range(5) for m in (transform(i), sensor(i))]
    words = f"--poses {poses} --wrenches {forces} --seconds 0.1 --json"
    with serving([at_once(sent)]) as port:
        told = run(f"record 127.0.0.1:{port} {words}").told
    assert told["pose_frames"] == told["wrench_frames"] == 5
    assert len(read_trajectory(poses)) == 5
    assert read_wrenches(forces).force[0].tolist() == [1, 2, 3]
    for file in (poses, forces):
        file.unlink()
    with serving([at_once(transform(i) for i in range(5))]) as port:
        # what came cannot be had again
        refused(run(f"record 127.0.0.1:{port} {words}"), "no forces arrived", "written")
    assert len(read_trajectory(poses)) == 5 and not forces.exists()
    poses.unlink()
    refused(run("record 127.0.0.1:nine --poses a.csv"), "HOST or HOST:PORT")
    refused(run("record 127.0.0.1"), "--poses or --wrenches")
    assert empty(output)


@pytest.mark.slow
def test_a_killed_recording_is_readable(output):
    """What is on disk after 0.3 s in place of 5 s; nothing half-written beside it."""
    pytest.importorskip("pyigtl", reason="needs pyigtl, which sends")
    from tests.sensors.test_open_igt_link import serving, transform
    from ttus_opt.probe.trajectory import read_trajectory

    poses = output / "poses.csv"
    with serving([transform(i) for i in range(3000)]) as port:
        code = (
            "import ttus_opt.sensors.open_igt_link as igt; igt.KEEPING = 0.3\n"
            "from ttus_opt.cli import main\n"
            f"main(['record', '127.0.0.1:{port}', '--poses', {str(poses)!r}])"
        )
        recording = subprocess.Popen([sys.executable, "-P", "-c", code])
        try:
            until = time.monotonic() + 60.0
            while not poses.exists() and time.monotonic() < until:
                time.sleep(0.02)
        finally:
            recording.kill()
            recording.wait()
    assert len(read_trajectory(poses)) > 20


def thousandfold(recording):
    """Torques in N mm under the unit N·m."""
    read = read_wrenches(recording / "force.nc")
    torque = 1e3 * read.torque
    wrenches = WrenchStream(read.time, read.force, torque)
    write_netcdf_wrenches(wrenches, recording / "force.nc")


def offset(recording):
    changed(recording, "clock", {"by": "offset", "offset": 1.33})


def point(recording):
    changed(recording, "force.sensor.point", [0.05, 0.0, -0.08])


def sign(recording):
    changed(recording, "force.sensor.sign", "by-probe")


def axes(recording):
    changed(recording, "force.sensor.axes", [0.0, 0.0, 0.0, 1.0])


#: All of them are found in tests/session too; here it is told, by a warning or an error
MISTAKES = {
    "check clock.offset in the description": offset,
    "give sign=on-probe": sign,
    "check force.sensor.point in the description": point,
    "check the unit of force.file in the description": thousandfold,
    "the poses jump by 50 mm": jumped,
    "the readings lie 45° from the stated axes": axes,
}


@pytest.mark.parametrize("told", some(MISTAKES, 0))
def test_strict_refuses_a_named_mistake(run, tmp_path, output, told):
    recording = copied(tmp_path)
    MISTAKES[told](recording)
    answer = run(f"session {recording} -o {output} --strict")
    assert answer.status == 2
    assert answer.errors[-1].startswith("error: ") and told in answer.errors[-1]
    assert not (output / "field.nc").exists() and not (output / "report.md").exists()

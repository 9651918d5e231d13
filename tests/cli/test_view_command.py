"""``ttus-opt view``: serves until Ctrl-C, and says what is wrong before it does."""

import signal
import sys
import urllib.request
from dataclasses import replace
from http.client import HTTPConnection
from urllib.error import HTTPError
from urllib.parse import urlsplit

import numpy as np
import pytest

import ttus_opt as tt
from tests.cli.conftest import PROBE
from tests.kit import started
from ttus_opt.core.interrupts import INTERRUPTED

pytest.importorskip("viser", reason="needs ttus-opt[viewer]")


@pytest.mark.slow
def test_it_serves_until_it_is_interrupted(field, files):
    words = f"view {field} --probe {PROBE} --trajectory {files / 'press.csv'}".split()
    process = started("-m", "ttus_opt", *words, "--port", "0", "--no-browser")
    url = process.stdout.readline().strip()
    told = process.stdout.readline()
    try:
        with urllib.request.urlopen(url, timeout=30) as page:
            assert b"<html" in page.read()
        with pytest.raises(HTTPError, match="403"):
            urllib.request.urlopen(f"http://{urlsplit(url).netloc}/", timeout=30)
    finally:
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert process.returncode in (0, INTERRUPTED)  # the latter while it reads
    assert told == "open this link on this machine; Ctrl-C ends it\n"
    assert "Traceback" not in err
    with pytest.raises(OSError):  # nobody is there any more
        HTTPConnection(urlsplit(url).netloc, timeout=5).request("GET", "/")


@pytest.fixture
def served(monkeypatch):
    """Stands for somebody who looks and presses Ctrl-C."""
    from ttus_opt.viewer.viewer import Viewer

    looked = []

    def wait(viewer):
        state = viewer.state
        looked.extend([*viewer.page.names, str(state.shell)])
        looked.append("recording" if state.recording else "none")
        raise KeyboardInterrupt

    monkeypatch.setattr(Viewer, "wait", wait)
    return looked


def test_two_fields_the_probe_and_a_recording_are_shown(run, field, files, served):
    press = files / "press.csv"
    told = run(
        f"view {field} --compare {field} --probe {PROBE} --points 300 "
        f"--trajectory {press} --port 0 --no-browser --json"
    ).told
    assert told["url"].startswith("http://127.0.0.1:")
    assert served[:2] == [field.stem, field.stem]
    assert "300 points" in served[2]
    assert served[3] == "recording"


def test_the_skin_is_drawn_before_the_probe_is_made(run, field, served, monkeypatch):
    from ttus_opt.viewer import patient_nodes, viewer

    done = []
    for module, name in ((patient_nodes, "patients_on"), (viewer, "probe_of")):
        own = getattr(module, name)

        def noted(*given, own=own):
            done.append(own.__name__)
            return own(*given)

        monkeypatch.setattr(module, name, noted)
    run(f"view {field} --port 0 --no-browser")
    assert done[:2] == ["patients_on", "probe_of"]


@pytest.mark.slow
def test_the_probe_is_the_one_of_the_fit(run, field, served):
    answer = run(f"view {field} --port 0 --no-browser")
    assert answer.status == 0, answer.err
    assert "40 × 30 × 30 mm" in served[1]


@pytest.mark.parametrize(
    ("words", "why"),
    [
        ("view --no-browser", "either a field file or --example"),
        ("view {field} --example", "either a field file or --example"),
        ("view --example --compare {field}", "needs a field file"),
        ("view missing.nc", "missing.nc"),
        ("view {broken}", "not"),
        ("view {field} --probe missing.stl", "missing.stl"),
        ("view {field} --port 99999", "0 to 65535"),
        ("view {surface}", "surface"),
    ],
)
def test_what_is_wrong_is_said_in_a_line(run, field, files, tmp_path, words, why):
    broken = tmp_path / "broken.nc"
    broken.write_bytes(field.read_bytes()[:2000])
    answer = run(words.format(field=field, broken=broken, surface=files / "surface.nc"))
    assert answer.status == 2
    assert len(answer.errors) == 1
    assert why in answer.errors[0]


def test_a_field_of_another_patient_is_refused(run, field, tmp_path, served):
    one, other = tt.PotentialField.load(field), tmp_path / "other.nc"
    surface = one.voxmap.surface
    larger = replace(surface, radius=1.02 * surface.radius)
    voxmap = tt.Voxmap.from_surface(larger, shape=one.voxmap.grid.shape, r_inner=0.03)
    tt.PotentialField(voxmap, np.zeros(voxmap.grid.shape), "trilinear").save(other)
    answer = run(f"view {field} --compare {other} --port 0 --no-browser")
    assert answer.status == 2
    assert len(answer.errors) == 1
    assert "on one patient" in answer.errors[0]
    assert served == []


def test_a_viser_that_is_missing_is_named(run, field, monkeypatch):
    monkeypatch.setitem(sys.modules, "viser", None)
    answer = run(f"view {field}")
    assert answer.status == 2
    assert 'pip install "ttus-opt[viewer]"' in answer.errors[0]

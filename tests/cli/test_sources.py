"""Where a field came from: what is kept of it, and what is said of other files."""

import hashlib
import importlib.metadata
import json
import platform
import warnings
from pathlib import Path

import pytest

from ttus_opt.cli import sources as module
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.sources import probe_for, seen, sources
from ttus_opt.core.errors import FileError, TtusWarning


def written(path, content):
    path.write_text(content)
    return path


@pytest.fixture(autouse=True)
def any_probe(monkeypatch):
    """None of the files here is a mesh."""
    monkeypatch.setattr(ProbeOptions, "read", lambda self: None)


@pytest.fixture
def recordings(tmp_path):
    files = [written(tmp_path / f"{name}.csv", f"t,{name}") for name in ("a", "b")]
    return RecordingOptions(files)


@pytest.fixture
def surface(tmp_path):
    return written(tmp_path / "surface.nc", "skin")


def kept(surface, recordings, probe="sphere:0.02"):
    typed = {"lam": 0.5, "sampling": "trilinear", "output": Path("f.nc"), "json": True}
    return sources(surface, ProbeOptions(probe), recordings, typed)


def sha256(content):
    return hashlib.sha256(content.encode()).hexdigest()


def nothing_said(of, probe, recordings):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        probe_for(of, probe, recordings)


def test_files_are_kept_by_name_and_hash(surface, recordings, tmp_path):
    mesh = written(tmp_path / "probe.stl", "solid")
    found = kept(surface, recordings, str(mesh))
    assert (found["probe"], found["surface"]) == ("probe.stl", "surface.nc")
    assert found["trajectories"] == "a.csv, b.csv"
    assert json.loads(found["recordings"]) == {
        "a.csv": sha256("t,a"),
        "b.csv": sha256("t,b"),
    }
    assert json.loads(found["hashes"]) == {
        "surface.nc": sha256("skin"),
        "probe.stl": sha256("solid"),
    }
    primitive = kept(surface, recordings)  # is no file
    assert primitive["probe"] == "sphere:0.02"
    assert set(json.loads(primitive["hashes"])) == {"surface.nc"}


def test_options_of_the_field_are_kept_and_no_others(surface, recordings):
    found = kept(surface, recordings)
    assert json.loads(found["options"]) == {"lam": 0.5, "sampling": "trilinear"}
    assert json.loads(found["conventions"])["torque_about"] == "centroid"


def test_versions_are_those_installed(surface, recordings, monkeypatch):
    monkeypatch.setattr(module, "PACKAGES", ("numpy", "no-such-package"))
    assert json.loads(kept(surface, recordings)["versions"]) == {
        "python": platform.python_version(),
        "numpy": importlib.metadata.version("numpy"),
        "no-such-package": "unknown",
    }


def test_a_recording_is_known_by_its_content(surface, recordings, tmp_path):
    renamed = written(tmp_path / "c.csv", "t,a")
    changed = written(tmp_path / "b.csv", "t,other")  # after what is kept of it
    of = {**kept(surface, recordings), "recordings": json.dumps({"b": sha256("t,a")})}
    assert seen(of, [renamed, changed]) == [
        {"name": "c.csv", "sha256": sha256("t,a"), "seen": True},
        {"name": "b.csv", "sha256": sha256("t,other"), "seen": False},
    ]
    assert [each["seen"] for each in seen({}, [renamed])] == [False]


def test_another_probe_is_told(surface, recordings):
    found = kept(surface, recordings)
    nothing_said(found, ProbeOptions("sphere:0.02"), recordings)
    with pytest.warns(TtusWarning, match=r"with probe sphere:0.02, this is box:1,1,1"):
        probe_for(found, ProbeOptions("box:1,1,1"), recordings)
    # a field of no known probe says nothing
    nothing_said({}, ProbeOptions("box:1,1,1"), recordings)


def test_a_probes_file_that_changed_is_told(surface, recordings, tmp_path):
    mesh = written(tmp_path / "probe.stl", "solid one")
    probe = ProbeOptions(str(mesh))
    found = kept(surface, recordings, str(mesh))
    nothing_said(found, probe, recordings)
    written(mesh, "solid two")
    with pytest.warns(TtusWarning, match=r"fitted with another file probe\.stl"):
        probe_for(found, probe, recordings)
    # without a hash of it there is nothing to compare
    nothing_said({**found, "hashes": "{}"}, probe, recordings)


@pytest.mark.parametrize(
    ("about", "told"),
    [
        ("centroid", ""),
        ("origin", "torques about origin, but these are about centroid"),
        ([0.0, 0.1, 0.0], r"torques about \(0.0, 0.1, 0.0\)"),
    ],
)
def test_torques_about_another_point_are_told(about, told, surface, recordings):
    conventions = json.dumps({"torque_about": about})
    found = {**kept(surface, recordings), "conventions": conventions}
    probe = ProbeOptions("sphere:0.02")
    if not told:
        nothing_said(found, probe, recordings)
        return
    with pytest.warns(TtusWarning, match=told):
        probe_for(found, probe, recordings)


@pytest.mark.parametrize("text", ["[1]", "{", ""])
@pytest.mark.parametrize("key", ["hashes", "conventions", "recordings"])
def test_damaged_provenance_is_told_by_its_key(
    key, text, surface, recordings, tmp_path
):
    mesh = written(tmp_path / "probe.stl", "solid")
    damaged = {**kept(surface, recordings, str(mesh)), key: text}
    with pytest.raises(FileError, match=f"field file's {key} are damaged"):
        if key == "recordings":
            seen(damaged, recordings.trajectory)
        else:
            probe_for(damaged, ProbeOptions(str(mesh)), recordings)

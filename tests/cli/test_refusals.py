"""What the commands refuse: one line, status 2, nothing written."""

import json
import sys
from dataclasses import replace

import numpy as np
import pytest

from tests.cli.conftest import PROBE, empty, fit_words, refused, scene_words
from tests.kit import presses, python, torso
from ttus_opt.cli import fit_command
from ttus_opt.probe.trajectory import Trajectory, read_trajectory

HEADER = "t,px,py,pz,qw,qx,qy,qz,fx,fy,fz,tx,ty,tz"
#: Command lines that are sound
SOUND = {
    "surface": "surface {files}/scan.npy -o {output}/s.nc",
    "fit": "fit {scene} -o {output}/f.nc",
    "tune": "tune {scene}",
    "path": "path {scene} -o {output}/p.nc",
    "next-press": "next-press {scene} -o {output}/n.csv",
    "refine-poses": "refine-poses {scene} -o {output}/r.csv",
    "evaluate": "evaluate --field {field} --trajectory {files}/press.csv",
    "render": "render --field {field} --trajectory {files}/press.csv -o {output}/r.csv",
}
#: A cloud that ends early
SHORT = (
    b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 500\n"
    b"HEIGHT 1\nPOINTS 500\nDATA binary\n" + bytes(600)
)


def cloud_words(scan, output):
    return f"surface {scan} -o {output / 's.nc'}"


CLOUDS = {
    "mm.npy": ["--unit mm"],
    "nan.npy": ["NaN", "--drop-nan"],
    "empty.ply": ["empty"],
    "short.pcd": ["short.pcd"],
}


@pytest.mark.parametrize("name", CLOUDS)
def test_clouds_that_are_none(run, files, tmp_path, output, name):
    cloud = np.load(files / "scan.npy")
    if name == "mm.npy":
        cloud *= 1e3
    cloud[7] = cloud[7] if name == "mm.npy" else np.nan
    if name.endswith(".npy"):
        np.save(tmp_path / name, cloud)
    else:
        (tmp_path / name).write_bytes(SHORT if name == "short.pcd" else b"")
    refused(run(cloud_words(tmp_path / name, output)), *CLOUDS[name])
    assert empty(output)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("t,px,py,pz,qw,qx,qy\n0,0,0,0,1,0,0\n", ["qz"]),
        (f"{HEADER}\n1{',0' * 3},1{',0' * 9}\n0{',0' * 3},1{',0' * 9}\n", ["line 3"]),
        (f"{HEADER}\n0{',0' * 3},2{',0' * 9}\n", ["quaternion", "line 2"]),
        (f"{HEADER}\n0{',0' * 13}\n", ["quaternion", "line 2"]),
        ("", ["empty"]),
    ],
    ids=["missing column", "unsorted time", "unnormalised", "zero", "empty"],
)
def test_bad_trajectory(run, files, tmp_path, output, text, words):
    bad = tmp_path / "bad.csv"
    bad.write_text(text)
    answer = run(fit_words(files, output / "f.nc", f"--trajectory {bad}"))
    refused(answer, "bad.csv", *words)
    assert empty(output)


REFUSALS = {
    "surface": [
        (
            "--n-theta 0 --no-support --axis-origin 0,0,0 --axis-direction 0,0,1",
            ["--n-theta must be", "0"],
        ),
        (
            "--no-support --axis-origin 4,0,0 --axis-direction 0,0,1",
            ["is nowhere near the axis"],
        ),
        ("--n-theta many", ["--n-theta", "valid int"]),
        ("--axis-origin 0,0,0", ["--axis-direction"]),
        ("--axis-origin 0,0 --axis-direction 0,0,1", ["--axis-origin", "3 numbers"]),
        ("--axis-origin 0,0,0 --axis-direction 0,0,0", ["--axis-direction", "zero"]),
        ("--picture s.gif", ["s.gif", ".png"]),
        ("--unit inch", ["unit", "inch"]),
        ("--colour red", ["--colour"]),
    ],
    "fit": [
        ("--probe ellipsoid:0,0,0", ["zero"]),
        ("--probe sphere:20", ["40 m", "give its measures in metres"]),
        ("--probe cone:1", ["cone:1", "ellipsoid"]),
        ("--probe nowhere.stl", ["nowhere.stl"]),
        ("--shape 4000,4000,4000", ["GiB", "smaller shape"]),
        ("--shape 16,24", ["--shape", "3 numbers"]),
        ("--shape 16.5,24,12", ["--shape", "whole"]),
        ("--sector 30,30", ["sector", "larger one"]),
        ("--sector=-10,nan", ["sector", "two angles"]),
        ("--sector front", ["--sector", "FROM,TO"]),
        ("--sector 90,90.0001", ["sector of 0.0001°", "at least 5°"]),
        ("--paper --weights auto", ["--paper", "leave --weights out"]),
        ("--weights best", ["--weights best is not known", "auto or own"]),
        ("--weights auto --force-weight 1", ["one or the other"]),
        ("--inner some", ["--inner", "some"]),
        ("--formulation eq11", ["eq11", "eq10"]),
        ("--option force_weight", ["--option", "key=value"]),
        ("--option colour=red", ["colour"]),
        ("--solver structred", ["structred", "structured"]),
        ("--sampling nearest", ["sampling", "nearest"]),
        ("--tolerance 0", ["tolerance"]),
        ("--r-inner 0.3", ["must exceed --r-inner 0.3 m"]),
        ("--points 2", ["--points must be"]),
        ("--wrench-delay 1e3", ["a --wrench-delay of 1000 s is longer"]),
    ],
    "tune": [
        ("--formulation none", ["unknown formulation"]),
        ("--formulation depth_map", ["cannot be tuned"]),
        ("--option force", ["--option takes"]),
    ],
    "path": [
        *((f"--weight {word}", ["--weight takes"]) for word in ("force", "=1,2")),
        *(
            (f"--weight force={word}", ["--weight takes"])
            for word in ("1:2", "2:1:5", "1:2:1", "a,b")
        ),
        ("--weight force=0,1", ["positive"]),
        ("--weight force,torque=nan,1", ["positive numbers, got 'force,torque=nan,1'"]),
        ("--weight force=-1,1", ["positive numbers, got 'force=-1,1'"]),
        ("--weight force=nan:1:5", ["0 < LOW < HIGH"]),
        ("--weight force=1,2 --weight force=3", ["given twice"]),
        ("--weight forse=1,2", ["no term 'forse'"]),
        ("--weight force=1,2 --picture x.doc", ["must end in"]),
        ("--weight force=1,2 --inner none", ["--inner takes"]),
        ("--weight force=1,2 --jobs 0", ["jobs must be at least 1"]),
        ("--weight force=1,2 --held-out gone.csv", ["gone.csv"]),
        ("--weight force=1,2 --formulation none", ["none"]),
        ("--weight force=1,2 --formulation eq10_sign --criteria", ["without limits"]),
    ],
    "next-press": [
        ("--angles 10", ["--angles takes two angles"]),
        ("--box 0,1", ["--box takes 6 numbers"]),
        ("--count 0", ["--count"]),
        ("--picture next.txt", ["next.txt"]),
    ],
    "refine-poses": [
        ("--position-noise 50", ["at most 10 mm, got 50 mm"]),
        ("--rotation-noise 0", ["above 0"]),
        ("--correlation -1", ["correlation time"]),
    ],
    # that it is another probe is not said of none
    "evaluate": [("--probe .", ["probe mesh . is a folder"])],
    "render": [("--probe gone.stl", ["not found: gone.stl"])],
}


@pytest.mark.parametrize(
    ("command", "more", "words"),
    [(name, *row) for name, rows in REFUSALS.items() for row in rows],
)
def test_bad_options(run, files, field, output, command, more, words):
    own = {"files": files, "output": output, "scene": scene_words(files)}
    own["field"] = field
    refused(run(f"{SOUND[command].format(**own)} {more}"), *words)
    assert empty(output)


NEED_FORCES = ["tune", "next-press -o {}/n.csv", "evaluate", "fit -o {}/f.nc"]


@pytest.mark.parametrize("command", NEED_FORCES)
def test_recordings_without_forces_are_named(run, files, field, output, command):
    presses, poses = read_trajectory(files / "press.csv"), files / "poses.csv"
    replace(presses, force=None, torque=None).save(poses)
    words = f"--field {field} --probe {PROBE} --trajectory {poses}"
    if command != "evaluate":
        words = scene_words(files).replace("press.csv", "poses.csv")
    refused(run(f"{command.format(output)} {words}"), "error: poses.csv: ", "fx")
    assert empty(output)


@pytest.mark.parametrize("what", ["force", "torque"])
def test_of_two_recordings_the_one_without_is_named(run, files, output, what):
    less = {"torque": None} if what == "torque" else {"torque": None, "force": None}
    presses, other = read_trajectory(files / "press.csv"), files / "other.csv"
    replace(presses, **less).save(other)
    answer = run(fit_words(files, output / "f.nc", f"--trajectory {other}"))
    refused(answer, f"{other} has no {what}s, and {files / 'press.csv'} has")
    assert empty(output)


def test_probe_mesh_of_zero_area(run, files, tmp_path, output):
    (tmp_path / "flat.obj").write_text("v 0 0 0\nv 10 0 0\nv 20 0 0\nf 1 2 3\n")
    answer = run(fit_words(files, output / "f.nc", f"--probe {tmp_path / 'flat.obj'}"))
    refused(answer, "zero area")
    assert empty(output)


def test_probe_mesh_in_the_wrong_unit(run, files, tmp_path, output):
    corners = "v 0 0 0\nv 30 0 0\nv 0 30 0\nv 0 0 30\n"
    (tmp_path / "mm.obj").write_text(f"{corners}f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    words = f"--probe {tmp_path / 'mm.obj'} --probe-unit m"
    refused(run(fit_words(files, output / "f.nc", words)), "--probe-unit mm")
    assert empty(output)


def test_probe_never_in_contact_is_refused(run, files, tmp_path):
    away = presses(torso(), 5, np.random.default_rng(1))
    Trajectory(
        away.time, 1.4 * away.position, away.rotation, away.force, away.torque
    ).save(tmp_path / "away.csv")
    words = (
        f"fit --surface {files / 'surface.nc'} --probe {PROBE} --points 300 "
        f"--shape 16,24,12 --trajectory {tmp_path / 'away.csv'} -o {tmp_path / 'f.nc'}"
    )
    answer = run(words)
    assert answer.status == 2
    assert "in none of 5 poses: there is nothing to fit" in answer.errors[-1]
    assert "Laplace field alone" not in answer.err
    assert not (tmp_path / "f.nc").exists()
    fitted = run(f"{words} --inner fit")
    assert fitted.status == 2
    assert fitted.errors[-1].startswith("error: --inner fit needs measured forces")


def test_field_of_another_version(run, files, field, tmp_path):
    import xarray as xr

    later = xr.load_dataset(field, engine="netcdf4").assign_attrs(ttus_opt_version=99)
    later.to_netcdf(tmp_path / "later.nc", engine="netcdf4")
    words = f"--probe {PROBE} --trajectory {files / 'press.csv'}"
    refused(
        run(f"evaluate --field {tmp_path / 'later.nc'} {words}"),
        "version 99",
        "update ttus_opt",
    )
    refused(run(f"evaluate --field {files / 'surface.nc'} {words}"), "surface")


def test_no_solution_writes_no_field(run, files, output, monkeypatch):
    monkeypatch.setattr(fit_command, "SOLVING", 0.0)  # nothing is left of the time
    words = fit_words(
        files, output / "f.nc", "--formulation eq10 --solver osqp --tolerance 1e-13"
    )
    answer = run(f"{words} --json")
    assert answer.status == 2
    told = json.loads(answer.out)
    assert told["status"] != "solved" and told["output"] is None
    assert answer.errors[-1].startswith("error: osqp on eq10: ")
    assert empty(output)


def test_nothing_is_half_written_into_a_folder_that_is_none(run, files, tmp_path):
    (tmp_path / "file").touch()
    refused(run(fit_words(files, tmp_path / "file" / "f.nc")), "cannot write")


def test_an_interrupt_is_one_line(run, files, output, monkeypatch):
    def stop(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("ttus_opt.contact.scene.Scene.assemble", stop)
    answer = run(fit_words(files, output / "f.nc"))
    assert answer.status == 130
    assert len(answer.errors) == 1
    assert empty(output)


@pytest.mark.parametrize(
    ("option", "text", "told"),
    [
        (
            "--formulation",
            "def build(scene):\n    return 1 / 0\n",
            "build() of formulation own raised ZeroDivisionError: division by zero (",
        ),
        ("--formulation", "import nothing_of_that_name\n", "raised ModuleNotFound"),
        ("--solver", "import nothing_of_that_name\n", "raised ModuleNotFoundError"),
    ],
    ids=["build", "import", "solver"],
)
def test_a_users_file_that_raises(run, files, tmp_path, output, option, text, told):
    """One line with the file and its own line, no traceback."""
    own = tmp_path / "own.py"
    own.write_text(text)
    answer = run(fit_words(files, output / "f.nc", f"{option} {own}"))
    assert answer.status == 2
    assert len(answer.errors) == 1
    assert told in answer.errors[0]
    assert f"({own}, line {text.count(chr(10))})" in answer.errors[0]
    assert empty(output)


def test_an_output_never_replaces_an_input(run, files, tmp_path):
    scan = tmp_path / "scan.npy"
    scan.write_bytes((files / "scan.npy").read_bytes())
    before = scan.read_bytes()
    refused(run(f"surface {scan} -o {scan}"), "would overwrite the input", "--force")
    press = tmp_path / "press.csv"
    press.write_bytes((files / "press.csv").read_bytes())
    words = f"--probe {PROBE} --trajectory {press}"
    refused(
        run(f"render --field no.nc {words} -o {press}"), "would overwrite the input"
    )
    own = tmp_path / "own.py"
    own.write_text("")
    words = fit_words(files, own, f"--formulation {own}")
    refused(run(words), "would overwrite the input")
    assert scan.read_bytes() == before


def test_two_outputs_are_two_files(run, files, tmp_path):
    same = tmp_path / "a.png"
    words = f"surface {files / 'scan.npy'} -o {same} --picture {same}"
    refused(run(words), "two outputs")
    assert empty(tmp_path)


def test_a_package_of_an_extra_is_named(run, output, monkeypatch):
    """Also where a module of ours imports it at its top."""
    for name in ("messages", "recording", "replay"):
        monkeypatch.delitem(sys.modules, f"ttus_opt.live.{name}", raising=False)
    monkeypatch.setitem(sys.modules, "msgspec", None)
    told = run(f"live replay --recording {output / 'x.mcap'}")
    install = 'error: msgspec is not installed: pip install "ttus-opt[live]"'
    assert (told.status, told.errors) == (2, [install])


def test_links_that_cannot_be_opened(run, output, monkeypatch):
    pytest.importorskip("msgspec", reason="needs ttus-opt[live]")
    key = output / "session.key"
    key.write_text(bytes(32).hex())
    monkeypatch.setitem(sys.modules, "aiortc", None)
    for side in ("operator", "follower"):
        words = f"live {side} --key {key} --link"
        refused(run(f"{words} wifi"), "--link is udp or webrtc, got wifi")
        refused(run(f"{words} udp --seconds nan"), "--seconds must be positive")
        told = run(f"{words} webrtc")
        install = 'error: aiortc is not installed: pip install "ttus-opt[webrtc]"'
        assert (told.status, told.errors) == (2, [install])


def test_a_memory_limit_that_is_none(run, output):
    answer = run(f"benchmark --case S --memory-limit nan -o {output / 'b'}")
    refused(answer, "--memory-limit must be positive [GiB]")
    assert empty(output)


def test_a_terminated_command_leaves_nothing_behind(tmp_path):
    code = (
        "import os, signal, sys, typer\n"
        "from ttus_opt.core import io\n"
        "from ttus_opt.cli import app as lines\n"
        "def begin(*_, **__):\n"
        f"    with io.replacing({str(tmp_path / 'a.nc')!r}):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "lines.program = lambda: begin\n"
        "lines.main(['demo'])\n"
    )
    python("-c", code, status=143)
    assert empty(tmp_path)

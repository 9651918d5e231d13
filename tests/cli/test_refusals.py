"""What the commands refuse: one line, status 2, nothing written."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.cli.conftest import PROBE, empty, fit_words, refused
from tests.conftest import presses, torso
from ttus_opt.cli import fit_command
from ttus_opt.probe.trajectory import Trajectory

HEADER = "t,px,py,pz,qw,qx,qy,qz,fx,fy,fz,tx,ty,tz"


def cloud_words(scan: Path, output: Path) -> str:
    return f"surface {scan} -o {output / 's.nc'}"


def test_millimetres_read_as_metres(run, files, tmp_path, output):
    np.save(tmp_path / "mm.npy", 1e3 * np.load(files / "scan.npy"))
    refused(run(cloud_words(tmp_path / "mm.npy", output)), "--unit mm")
    assert empty(output)


def test_nan_coordinates(run, files, tmp_path, output):
    cloud = np.load(files / "scan.npy")
    cloud[7] = np.nan
    np.save(tmp_path / "nan.npy", cloud)
    refused(run(cloud_words(tmp_path / "nan.npy", output)), "NaN", "--drop-nan")
    assert empty(output)


def test_empty_cloud(run, tmp_path, output):
    (tmp_path / "empty.ply").touch()
    refused(run(cloud_words(tmp_path / "empty.ply", output)), "empty")
    assert empty(output)


def test_truncated_cloud(run, tmp_path, output):
    (tmp_path / "short.pcd").write_bytes(
        b"VERSION .7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\nWIDTH 500\n"
        b"HEIGHT 1\nPOINTS 500\nDATA binary\n" + bytes(600)
    )
    refused(run(cloud_words(tmp_path / "short.pcd", output)), "short.pcd")
    assert empty(output)


def test_cloud_that_never_meets_the_axis(run, files, output):
    words = cloud_words(files / "scan.npy", output)
    refused(
        run(f"{words} --no-support --axis-origin 4,0,0 --axis-direction 0,0,1"),
        "is nowhere near the axis",
    )
    assert empty(output)


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (
            "--n-theta 0 --no-support --axis-origin 0,0,0 --axis-direction 0,0,1",
            ["n_theta", "0"],
        ),
        ("--n-theta many", ["--n-theta", "valid int"]),
        ("--axis-origin 0,0,0", ["--axis-direction"]),
        ("--axis-origin 0,0 --axis-direction 0,0,1", ["--axis-origin", "3 numbers"]),
        ("--axis-origin 0,0,0 --axis-direction 0,0,0", ["--axis-direction", "zero"]),
        ("--picture s.gif", ["s.gif", ".png"]),
        ("--unit inch", ["unit", "inch"]),
        ("--colour red", ["--colour"]),
    ],
)
def test_surface_options(run, files, output, more, words):
    refused(run(f"{cloud_words(files / 'scan.npy', output)} {more}"), *words)
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


@pytest.mark.parametrize(
    ("more", "words"),
    [
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
        ("--inner some", ["--inner", "some"]),
        ("--formulation eq11", ["eq11", "eq10"]),
        ("--option force_weight", ["--option", "key=value"]),
        ("--option colour=red", ["colour"]),
        ("--solver structred", ["structred", "structured"]),
        ("--sampling nearest", ["sampling", "nearest"]),
        ("--tolerance 0", ["tolerance"]),
        ("--r-inner 0.3", ["r_inner"]),
    ],
)
def test_fit_options(run, files, output, more, words):
    refused(run(fit_words(files, output / "f.nc", more)), *words)
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
    words = fit_words(files, output / "f.nc", "--solver osqp --tolerance 1e-13")
    answer = run(f"{words} --json")
    assert answer.status == 2
    told = json.loads(answer.out)
    assert told["status"] != "solved" and told["output"] is None
    assert answer.errors[-1].startswith("error: osqp on depth_map: ")
    assert empty(output)


def test_nothing_is_half_written_into_a_folder_that_is_none(run, files, tmp_path):
    (tmp_path / "file").touch()
    refused(run(fit_words(files, tmp_path / "file" / "f.nc")), "cannot write")


def test_an_interrupt_is_one_line(run, files, output, monkeypatch):
    def stop(*_: object, **__: object) -> None:
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
    assert scan.read_bytes() == before


def test_two_outputs_are_two_files(run, files, tmp_path):
    same = tmp_path / "a.png"
    words = f"surface {files / 'scan.npy'} -o {same} --picture {same}"
    refused(run(words), "two outputs")
    assert empty(tmp_path)


def test_a_terminated_command_leaves_nothing_behind(tmp_path):
    code = (
        "import os, signal, sys, typer\n"
        "from ttus_opt.core import io\n"
        "from ttus_opt.cli import app as lines\n"
        "def begin(*_, **__):\n"
        f"    with io.replacing({str(tmp_path / 'a.nc')!r}):\n"
        "        os.kill(os.getpid(), signal.SIGTERM)\n"
        "lines.app = begin\n"
        "lines.main(['demo'])\n"
    )
    done = subprocess.run([sys.executable, "-c", code], timeout=60, check=False)
    assert done.returncode == 143
    assert empty(tmp_path)

"""Recordings of a camera's or a robot's frame and of forces alone, by the commands."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.cli.conftest import refused
from ttus_opt import example
from ttus_opt.probe.rigid_motion import inverse

SURFACE = example.path("surface.nc")
PLACE = tt.Surface.load(SURFACE).axis.scan_to_patient
BASE_TO_SCAN = np.eye(4)
BASE_TO_SCAN[:3, :3] = Rotation.from_rotvec([0.4, -2.0, 1.0]).as_matrix()
BASE_TO_SCAN[:3, 3] = 0.6, -0.3, 0.2


def recording(name="press_fit"):
    return tt.read_trajectory(example.path(f"{name}.csv")).select(slice(0, 400, 20))


def fit_words(recording, output, more=""):
    return (
        f"fit --surface {SURFACE} --probe {example.PROBE} --trajectory {recording} "
        f"--shape 12,24,12 --points 200 --inner 10 --sampling trilinear "
        f"-o {output} {more}"
    )


def evaluate_words(field, recording, more=""):
    return (
        f"evaluate --field {field} --probe {example.PROBE} --points 200 "
        f"--trajectory {recording} {more} --json"
    )


@pytest.mark.slow
def test_every_frame_gives_the_same_field(run, tmp_path):
    own = recording()
    scan = own.transformed(inverse(PLACE))
    base = scan.transformed(inverse(BASE_TO_SCAN))
    np.savetxt(tmp_path / "base.txt", BASE_TO_SCAN)
    fields = {}
    for name, trajectory, options in (
        ("patient", own, ""),
        ("scan", scan, "--frame scan"),
        ("base", base, f"--base-to-scan {tmp_path / 'base.txt'}"),
    ):
        trajectory.save(tmp_path / f"{name}.csv")
        answer = run(
            fit_words(tmp_path / f"{name}.csv", tmp_path / f"{name}.nc", options)
        )
        assert answer.status == 0, answer.err
        assert (
            f"poses in the {name}'s frame, wrenches in the {name}'s axes" in answer.out
        )
        fields[name] = tt.PotentialField.load(tmp_path / f"{name}.nc").values
    np.testing.assert_allclose(fields["scan"], fields["patient"], atol=1e-6)
    np.testing.assert_allclose(fields["base"], fields["patient"], atol=1e-6)
    # what is rendered beside poses of a frame is compared in that frame
    options = f"--base-to-scan {tmp_path / 'base.txt'}"
    rendered = tmp_path / "rendered.csv"
    words = evaluate_words(tmp_path / "base.nc", tmp_path / "base.csv", options)
    assert run(words.replace("evaluate", f"render -o {rendered}")).status == 0
    errors = run(evaluate_words(tmp_path / "base.nc", rendered, options)).told
    assert errors["force_magnitude_error_N"] < 1e-9
    assert errors["torque_magnitude_error_Nm"] < 1e-9
    np.testing.assert_allclose(
        tt.read_trajectory(rendered).position, base.position, atol=1e-9
    )


def test_recordings_of_the_scan_read_as_the_patients_are_told(run, tmp_path):
    recording().transformed(inverse(PLACE)).save(tmp_path / "scan.csv")
    wrong = run(fit_words(tmp_path / "scan.csv", tmp_path / "wrong.nc"))
    assert (
        "100 % of the poses lie near it in the scan frame: read them with --frame scan"
        in (wrong.err)
    )
    right = run(fit_words(tmp_path / "scan.csv", tmp_path / "r.nc", "--frame scan"))
    assert "--frame" not in right.err


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ("--frame base", ["--frame base needs --base-to-scan"]),
        ("--frame hand", ["--frame must be one of patient, scan, base"]),
        ("--wrench-frame hand", ["--wrench-frame must be"]),
        ("--base-to-scan nowhere.txt", ["--base-to-scan", "not found: nowhere.txt"]),
        ("--base-to-scan 1,2,3", ["--base-to-scan", "got 3 numbers"]),
        ("--base-to-scan 400,0,0,0,0,0,1", ["millimetres"]),
        ("--base-to-scan 0,0,0,0,0,0,2", ["length 2, expected 1"]),
        ('--base-to-scan "[[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]"', ["scales by 2"]),
        ("--base-to-scan -1,0,0,0,0,1,0,0,0,0,1,0,0,0,0,1", ["a reflection"]),
        ("--frame scan --base-to-scan 0,0,0,0,0,0,1", ["frame is scan, give base"]),
    ],
)
def test_what_is_no_frame_is_refused(run, tmp_path, options, words):
    answer = run(fit_words(example.path("press_fit.csv"), tmp_path / "f.nc", options))
    refused(answer, *words)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_forces_alone(run, tmp_path):
    replace(recording(), torque=None).save(tmp_path / "force.csv")
    fitted = run(fit_words(tmp_path / "force.csv", tmp_path / "f.nc"))
    assert fitted.status == 0, fitted.err
    assert "no torques were measured: forces alone were fitted" in fitted.out
    assert "no torques, " in fitted.out
    words = evaluate_words(tmp_path / "f.nc", tmp_path / "force.csv")
    told = run(words).told
    assert told["torque_magnitude_error_Nm"] is None
    assert told["force_magnitude_error_N"] < 2.0
    assert "torque  not measured" in run(words.replace("--json", "")).out


@pytest.mark.slow
def test_head_and_box(run, tmp_path):
    words = (
        f"surface {example.path('scan.ply')} -o {tmp_path / 's.nc'} --n-theta 36 "
        "--n-z 8"
    )
    found = run(words)
    assert "the head lies towards (-0.96, -0.22, -0.17)" in found.out
    assert "if not, add --flip-axis" in found.out
    z = tt.Surface.load(tmp_path / "s.nc").axis.rotation[:, 2]
    given = run(f"{words} --head 1,0,0 --box -2,2,-2,2,-2,2 --json").told
    np.testing.assert_allclose(np.array(given["axis_rotation"])[:, 2], -z, atol=1e-12)
    refused(run(f"{words} --head 0,0,1"), "away from the body's axis")
    refused(run(f"{words} --head 1,0,0 --flip-axis"), "--head or --flip-axis")
    refused(run(f"{words} --box 5,6,5,6,5,6"), "the scan reaches x", "--box"[2:])
    refused(run(f"{words} --box 1,2,3"), "--box takes 6 numbers")

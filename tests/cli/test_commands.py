"""The commands do what they say."""

import importlib.metadata
import json
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.cli.conftest import PROBE, fit_words, judged, refused
from tests.kit import presses, python, torso
from ttus_opt.haptic.field_wrench import wrenches_along
from ttus_opt.haptic.flat_file import write_flat


@pytest.mark.slow
def test_surface_writes_what_it_says(run, files, tmp_path):
    output, picture = tmp_path / "s.nc", tmp_path / "s.png"
    told = run(
        f"surface {files / 'scan.npy'} -o {output} --n-theta 90 --n-z 20 --no-support "
        "--axis-origin 0,0,0 --axis-direction 0,0,2 "
        f"--picture {picture} --json"
    ).told
    found = tt.Surface.load(output)
    assert told["n_theta"] == 90 and found.radius.shape == (90, 20)
    np.testing.assert_array_equal(found.axis.rotation, np.eye(3))
    theta, z = np.meshgrid(found.theta, found.z, indexing="ij")
    assert np.abs(found.radius - torso().radius_at(theta, z)).max() < 3e-3
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_axis_from_takes_the_frame_of_a_file(run, files, tmp_path):
    answer = run(
        f"surface {files / 'scan.npy'} -o {tmp_path / 's.nc'} --no-support --n-z 20 "
        f"--n-theta 60 --axis-from {files / 'surface.nc'}"
    )
    assert answer.status == 0, answer.err
    assert "60 x 20 radii" in answer.out


def test_surface_tells_how_sure_it_is_of_what_it_filled(run, files, tmp_path):
    cloud = np.load(files / "scan.npy")
    np.save(tmp_path / "front.npy", cloud[cloud[:, 0] > 0.0])
    words = (
        f"surface {tmp_path / 'front.npy'} -o {tmp_path / 's.nc'} --no-support "
        f"--n-theta 60 --n-z 20 --axis-from {files / 'surface.nc'}"
    )
    told = run(words + " --json").told
    found = tt.Surface.load(tmp_path / "s.nc")
    seen, std = found.observed, found.radius_std
    for name, own in (("observed", std[seen]), ("filled", std[~seen])):
        assert told[f"std_{name}_m"] == pytest.approx(np.median(own))
    assert told["std_largest_m"] == pytest.approx(std.max())
    said = f"{1e3 * np.median(std[~seen]):.0f} mm where filled (medians)"
    assert said in run(words).out


def test_fit_json_has_the_stable_keys(run, files, tmp_path):
    output = tmp_path / "field.nc"
    told = run(fit_words(files, output, "--force-weight 1e-2 --json")).told
    assert told["status"] == "solved"
    assert told["formulation"] == "eq10"
    assert told["voxels"] == 16 * 24 * 12
    assert set(told["seconds"]) == {"assembly", "setup", "solve", "compile"}
    assert set(told["costs"]) == {"laplace", "force", "torque"}
    assert told["objective"] == pytest.approx(sum(told["costs"].values()))
    assert told["kkt"]["dual_relative"] < 1e-6
    assert told["parameters"]["boundary_scale"] > 0
    found = tt.PotentialField.load(output)
    assert found.provenance["probe"] == PROBE
    assert found.provenance["trajectories"] == "press.csv"


@pytest.mark.slow
def test_fit_tells_how_well_parameters_are_known(run, files, tmp_path):
    """Named with its standard error, or with the reason and the neutral value."""
    sliding, still = tt.read_trajectory(files / "press.csv"), tmp_path / "still.csv"
    n = len(sliding)
    replace(
        sliding,
        position=np.repeat(sliding.position[:1], n, axis=0),
        rotation=np.repeat(sliding.rotation[:1], n, axis=0),
    ).save(still)
    words = fit_words(files, tmp_path / "f.nc", "--formulation coulomb_global")
    words = words.replace("--inner fit", "--inner 3.0")
    words = words.replace(str(files / "press.csv"), str(still))
    told = run(f"{words} --json").told
    assert told["parameters"]["friction_coefficient"] == 0.0
    assert told["not_identified"] == {"friction_coefficient": "no sliding"}
    assert told["standard_errors"] == {}
    answer = run(words)
    line = "friction_coefficient: not identified (no sliding): 0 is used"
    assert line in answer.out.splitlines()
    eq10 = "--formulation eq10"
    answer = run(fit_words(files, tmp_path / "f.nc", eq10))
    told = run(fit_words(files, tmp_path / "f.nc", f"{eq10} --json")).told
    scale, error = (
        told[key]["boundary_scale"] for key in ("parameters", "standard_errors")
    )
    assert 0.0 < error < scale
    found = [k for k in answer.out.splitlines() if k.startswith("boundary_scale")]
    value, sign, spread = found[0].split()[1:]
    assert sign == "±"
    assert float(spread) == pytest.approx(error, rel=0.05)
    assert float(value) == pytest.approx(scale, abs=error)
    stored = tt.PotentialField.load(tmp_path / "f.nc").standard_errors
    assert stored == {"boundary_scale": error}


@pytest.mark.slow
def test_a_fit_that_fails_still_draws_the_poses(run, files, tmp_path):
    picture = tmp_path / "poses.png"
    answer = run(
        fit_words(files, tmp_path / "f.nc", f"--flip-wrench --picture {picture}")
    )
    assert answer.status == 2
    assert "push into the patient" in answer.err
    assert picture.read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_options_reach_the_formulation(run, files, tmp_path):
    own = tmp_path / "own.py"
    own.write_text(
        "from formulations.eq10 import build as eq10\n"
        "def build(scene, strength=1.0, label=''):\n"
        "    assert label == 'soft'\n"
        "    return eq10(scene, force_weight=strength, torque_weight=0.0)\n"
    )
    a = run(
        fit_words(
            files,
            tmp_path / "a.nc",
            f"--formulation {own} --option strength=0.5 --option label=soft "
            "--weights own --json",
        )
    )
    b = run(
        fit_words(
            files, tmp_path / "b.nc", "--force-weight 0.5 --torque-weight 0 --json"
        )
    )
    assert a.status == 0 and b.status == 0, a.err + b.err
    assert json.loads(a.out)["formulation"] == "own"
    assert json.loads(a.out)["objective"] == pytest.approx(
        json.loads(b.out)["objective"], rel=1e-9
    )


def test_evaluate_says_what_a_hand_could_tell_apart(run, files, field):
    words = f"evaluate --field {field} {judged(files)}"
    told, spoken = run(f"{words} --json").told, run(words).out
    share = told["share_told_apart"]
    assert 0.0 < share <= 1.0
    assert f"{100 * share:.1f} % of the frames in contact differ" in spoken
    for key, word in (("error", "mean"), ("rmse", "rmse")):
        torque = 1e3 * told[f"torque_magnitude_{key}_Nm"]
        assert f"{torque:.1f} mN m {word}" in spoken


def test_evaluate_tells_errors_by_recording_distance_and_depth(
    run, files, field, tmp_path
):
    other = tmp_path / "other.csv"
    presses(torso(), 20, np.random.default_rng(5)).save(other)
    words = judged(files)
    both = f"evaluate --field {field} {words} --trajectory {other}"
    told = run(f"{both} --json").told
    alone = run(f"evaluate --field {field} {words} --json")
    own, unseen = told["by_recording"]
    whole = json.loads(alone.out)
    assert own["errors"].items() <= whole.items()
    mean = "force_magnitude_error_N"
    errors = 30 * own["errors"][mean] + 20 * unseen["errors"][mean]
    assert told[mean] == pytest.approx(errors / 50)
    # presses that were fitted are near, and none is deeper than the deepest
    assert [one["frames"] > 0 for one in whole["by_distance_m"]] == [True] + 3 * [False]
    assert whole["by_relative_depth"][-1]["frames"] == 0
    kinds = told["by_distance_m"], told["by_relative_depth"]
    frames = [sum(one["frames"] for one in kind) for kind in kinds]
    assert frames[0] == frames[1] > 30
    table = run(both).out
    assert "\npress.csv " in table and "\nother.csv " in table
    assert "\n0 to 2 cm from fitted places" in table
    assert "\n0.5 to 1 of the deepest fitted" in table


def test_evaluate_says_when_the_fitted_places_are_unknown(run, files, field, tmp_path):
    older = tt.PotentialField.load(field)
    kept = {k: v for k, v in older.provenance.items() if k != "contacts"}
    replace(older, provenance=kept).save(tmp_path / "older.nc")
    replace(older, provenance={**kept, "contacts": "{}"}).save(tmp_path / "damaged.nc")
    words = f"evaluate --field {tmp_path / 'older.nc'} {judged(files)}"
    assert "near and far: unknown" in run(words).out
    told = run(f"{words} --json").told
    assert told["by_distance_m"] is None and told["by_relative_depth"] is None
    damaged = run(words.replace("older.nc", "damaged.nc"))
    refused(damaged, "contacts are damaged", "fit the field again")


@pytest.mark.slow
def test_fit_keeps_its_uncertainty_for_evaluate(run, files, field, tmp_path):
    own, picture = tmp_path / "own.nc", tmp_path / "uncertainty.png"
    more = f"--formulation depth_map --uncertainty-picture {picture}"
    assert run(fit_words(files, own, more)).status == 0
    assert picture.stat().st_size > 0
    words = f"evaluate --field {own} {judged(files)}"
    (one,) = run(f"{words} --uncertainty --json").told["by_recording"]
    assert one["name"] == "press.csv" and one["frames"] == 30
    told = one["uncertainty"]
    assert told["force_std_N"] > 0.0 and 0.0 <= told["force_coverage"] <= 1.0
    drawn = tmp_path / "calibration.png"
    spoken = run(f"{words} --calibration-picture {drawn}")
    assert drawn.stat().st_size > 0
    assert "the 95 % interval covers" in spoken.out
    drawn.unlink()
    words = words.replace(str(own), str(field))
    refused = run(f"{words} --calibration-picture {drawn}")
    assert not drawn.exists()
    assert refused.status == 2 and "fit --uncertainty" in refused.errors[-1]


@pytest.mark.slow
def test_fit_says_when_there_is_no_uncertainty(run, files, tmp_path):
    own = tmp_path / "own.nc"
    answer = run(fit_words(files, own, "--formulation robust --uncertainty"))
    assert answer.status == 0 and own.exists()
    assert "written without uncertainty: no uncertainty for robust" in answer.err


def test_render_gives_what_evaluate_compares(run, files, field, tmp_path):
    output = tmp_path / "rendered.csv"
    words = f"--field {field} {judged(files)}"
    assert run(f"render {words} -o {output} --json").told["frames"] == 30
    own = words.replace(str(files / "press.csv"), str(output))
    assert run(f"evaluate {own} --json").told["force_vector_rmse_N"] < 1e-12
    length = f"render {words} -o {tmp_path / 'r.csv'} --presliding-length"
    refused = run(f"{length} -1")
    assert refused.status == 2 and not (tmp_path / "r.csv").exists()
    assert "--presliding-length of a field must not be negative" in refused.err
    without = run(f"{length} 1e-3")
    assert without.status == 0 and "has no friction" in without.err


def test_render_writes_the_flat_file_too(run, files, field, tmp_path):
    flat = tmp_path / "field.flat"
    words = f"render --field {field} {judged(files)} -o {tmp_path / 'r.csv'}"
    answer = run(f"{words} --flat {flat} --force-limit 15")
    assert answer.status == 0 and f"{flat}: field and probe" in answer.out
    shell = tt.PointShell.from_spec(PROBE, n_points=300)
    expected = tmp_path / "expected.flat"
    write_flat(expected, tt.PotentialField.load(field), shell, force_limit=15.0)
    assert flat.read_bytes() == expected.read_bytes()


def test_render_takes_another_presliding_length(run, files, field, tmp_path):
    held, output = tmp_path / "held.nc", tmp_path / "rendered.csv"
    potential = tt.PotentialField.load(field)
    law = {"friction_coefficient": 0.3, "presliding_length": 1e-2}
    replace(potential, parameters=law).save(held)
    words = f"render --field {held} {judged(files)} -o {output}"
    assert run(f"{words} --presliding-length 1e-3").status == 0
    own = replace(potential, parameters={**law, "presliding_length": 1e-3})
    shell = tt.PointShell.from_spec(PROBE, n_points=300)
    expected = wrenches_along(own, shell, tt.read_trajectory(files / "press.csv"))
    found = tt.read_trajectory(output)
    np.testing.assert_allclose(found.force, expected.force, atol=1e-6)


def test_no_command_shows_the_help(run):
    assert run("").out == run("--help").out


def test_version(run):
    assert (
        run("--version").out == f"ttus-opt {importlib.metadata.version('ttus-opt')}\n"
    )


@pytest.mark.slow
def test_module_runs_as_a_process(tmp_path):
    process = python("-m", "ttus_opt", "surface", status=2)
    assert process.stdout == ""
    assert len(process.stderr.splitlines()) == 1
    assert process.stderr.startswith("error: missing: ")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("used", "unwanted"),
    [
        (
            "import ttus_opt; ttus_opt.Renderer; ttus_opt.PotentialField",
            ("cvxpy", "qpsolvers", "cv2", "matplotlib"),
        ),
        # what is typed is answered at once
        ("import ttus_opt.cli.app", ("numpy", "numba", "scipy", "xarray")),
    ],
)
def test_nothing_is_loaded_that_is_not_used(used, unwanted):
    code = f"import sys; {used}; print([m for m in {unwanted} if m in sys.modules])"
    assert python("-c", code).stdout.strip() == "[]"

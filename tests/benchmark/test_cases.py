"""Cases: what they are made of, and what stands in for them."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from tests.kit import FileError, InputError, python, refuses
from ttus_opt import example
from ttus_opt.benchmark.cases import (
    PERTURBATIONS,
    CaseSpec,
    existing,
    perturbed,
    reference_cases,
    with_new_values,
)
from ttus_opt.probe.trajectory import read_trajectory


def test_reference_cases_have_the_sizes_of_the_design():
    sizes = {case.name: (case.n_voxels, case.n_poses) for case in reference_cases()}
    assert sizes == {"S": (51_840, 200), "M": (345_600, 400), "L": (1_080_000, 400)}


def test_the_largest_case_comes_on_request():
    (case,) = reference_cases("XL")
    assert case.shape == (200, 360, 150) and case.n_poses == 400
    assert [case.name for case in reference_cases("all, XL")] == ["S", "M", "L", "XL"]


def test_reference_cases_by_name():
    assert [case.name for case in reference_cases("M")] == ["M"]
    assert [case.name for case in reference_cases("M, S")] == ["S", "M"]
    refuses(InputError, "unknown case 'XXL'", reference_cases, "S,XXL")


def test_sampled_otherwise_a_case_has_another_name_and_inner_value():
    case = reference_cases("S")[0]
    assert case.sampled("trilinear") == case
    other = case.sampled("voxel-mean")
    assert other.name == "S-voxel-mean" and other.inner == "fit"
    assert other.small().scene().sampling == "voxel-mean"


def test_small_case_touches_and_new_values_change_values_only():
    scene = replace(reference_cases("S")[0].small(), n_poses=24).scene()
    assert len(scene.trajectory) == 24
    assert (scene.rows.contact_points > 0).any()
    other = with_new_values(scene, seed=1)
    assert other.N is scene.N
    assert other.L is scene.L
    assert 0.0 < np.linalg.norm(other.f - scene.f) < 0.2 * np.linalg.norm(scene.f)
    again = with_new_values(scene, seed=1)
    np.testing.assert_array_equal(other.tau, again.tau)


WARM_UP_PROGRAM = """
import gc
import numpy as np
from numba.core.dispatcher import Dispatcher
from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import Voxmap

def ready():
    return {
        f"{each.py_func.__module__}.{each.py_func.__name__} {signature}"
        for each in gc.get_objects() if isinstance(each, Dispatcher)
        for signature in each.signatures
    }

def solve(case):
    surface = Surface.load(case.surface)
    voxmap = Voxmap.from_surface(surface, shape=case.shape, r_inner=case.r_inner)
    laplace = LaplaceSystem.assemble(voxmap)
    laplace.solve(laplace.solve_adjoint(np.ones(case.n_voxels)))

(case,) = reference_cases("S")
solve(case.small())
before = ready()
solve(case)
print(len(before), *sorted(ready() - before), sep="\\n")
"""


@pytest.mark.slow
def test_small_case_compiles_all_that_a_case_calls():
    # in a process of its own: in this one other tests have compiled much already
    told = python("-c", WARM_UP_PROGRAM)
    count, *late = told.stdout.split("\n")[:-1]
    assert int(count) > 5
    assert not late


def test_existing_makes_paths_absolute(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("s.nc", "a.csv"):
        Path(name).write_text("x")
    files = {"surface": "s.nc", "probe": "sphere:0.02", "trajectories": ("a.csv",)}
    case = CaseSpec((4, 6, 4), name="user", **files)
    found = existing(case)
    assert found.surface == str(tmp_path / "s.nc")
    assert found.trajectories == (str(tmp_path / "a.csv"),)
    assert found.probe == "sphere:0.02"
    with pytest.raises(FileError, match=r"probe file not found.*probe\.stl"):
        existing(replace(case, probe="probe.stl"))


PLAIN = read_trajectory(example.path("press_fit.csv"))
assert PLAIN.force is not None
assert PLAIN.torque is not None
FORCE, TORQUE = PLAIN.force, PLAIN.torque


@pytest.mark.parametrize("how", PERTURBATIONS)
def test_poses_stay_and_wrenches_change_alike_every_time(how):
    once, twice = perturbed(PLAIN, how), perturbed(PLAIN, how)
    np.testing.assert_array_equal(once.position, PLAIN.position)
    np.testing.assert_array_equal(once.rotation, PLAIN.rotation)
    np.testing.assert_array_equal(once.force, twice.force)
    assert not np.array_equal(once.force, FORCE)


def test_noise_has_the_size_it_says():
    found = perturbed(PLAIN, "noise")
    for added, size in ((found.force - FORCE, 2.0), (found.torque - TORQUE, 0.03)):
        # 1200 draws: the deviation is known to 2 %, the mean to 3 % of it
        assert added.std() == pytest.approx(size, rel=0.08)
        assert abs(added.mean()) < 0.12 * size
        assert abs(np.corrcoef(added[:, 0], added[:, 1])[0, 1]) < 0.2


def test_a_fifth_of_the_frames_is_turned_round_whole():
    found = perturbed(PLAIN, "reversed")
    assert found.force is not None
    turned = (found.force == -FORCE).all(axis=1) & (FORCE != 0.0).any(axis=1)
    kept = (found.force == FORCE).all(axis=1)
    assert len(PLAIN) == 400
    assert turned.sum() == 80
    assert (turned ^ kept).all()
    np.testing.assert_array_equal(found.torque[turned], -TORQUE[turned])
    np.testing.assert_array_equal(found.torque[kept], TORQUE[kept])


def test_nothing_asked_for_is_nothing_changed():
    assert perturbed(PLAIN, "") is PLAIN


def test_what_cannot_be_perturbed():
    with pytest.raises(
        InputError, match="unknown perturbation 'loud': choose from noise"
    ):
        perturbed(PLAIN, "loud")
    with pytest.raises(InputError, match="trajectory has none"):
        perturbed(replace(PLAIN, force=None, torque=None), "noise")


def test_a_case_carries_its_perturbation_to_its_scene():
    plain = replace(reference_cases("S")[0].small(), n_poses=24)
    assert plain.perturbed("") == plain
    noisy = plain.perturbed("noise")
    assert noisy.name == "S-noise"
    assert CaseSpec.from_dict(json.loads(json.dumps(asdict(noisy)))) == noisy
    scene, other = plain.scene(), noisy.scene()
    assert abs(scene.N - other.N).max() == 0.0
    assert (other.f - scene.f).std() == pytest.approx(2.0, rel=0.4)
    refuses(InputError, "unknown perturbation", plain.perturbed, "loud")

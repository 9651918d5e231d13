"""Perturbed recordings: only wrenches change, by what is said, and always alike."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt import example
from ttus_opt.benchmark.cases import PERTURBATIONS, CaseSpec, perturbed, reference_cases
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import read_trajectory

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
        InputError, match="unknown perturbation 'loud': choose noise or"
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
    scene, other = plain.build(), noisy.build()
    assert abs(scene.N - other.N).max() == 0.0
    assert (other.f - scene.f).std() == pytest.approx(2.0, rel=0.4)
    refuses(InputError, "unknown perturbation", plain.perturbed, "loud")

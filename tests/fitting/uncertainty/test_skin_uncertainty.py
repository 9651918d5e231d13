"""The map over the skin against the uncertainty of single presses."""

import functools
from dataclasses import replace

import numpy as np
import pytest

from tests.fitting.uncertainty.test_field_uncertainty import (
    KEPT_SHARE,
    fitted,
    three_presses,
)
from tests.kit import InputError, torso
from ttus_opt.fitting.uncertainty import skin_uncertainty
from ttus_opt.fitting.uncertainty.field_uncertainty import uncertainty
from ttus_opt.fitting.uncertainty.saved_uncertainty import save_with_uncertainty
from ttus_opt.fitting.uncertainty.skin_uncertainty import uncertainty_map
from ttus_opt.voxmap.field import PotentialField
from ttus_opt.voxmap.voxmap import Voxmap


@functools.cache
def drawn():
    return uncertainty(fitted(), three_presses(), method="samples")


def test_presses_reach_the_depth_asked_for():
    scene = three_presses()
    theta, z = np.array([0.3, 2.0, 4.0]), np.array([0.05, 0.1, 0.15])
    presses = skin_uncertainty.presses_at(scene, theta, z, 0.006)
    assert len(presses) == 3
    for R, x in zip(presses.rotation, presses.position, strict=True):
        points = scene.shell.points @ R.T + x
        angle = np.arctan2(points[:, 1], points[:, 0])
        skin = scene.voxmap.surface.radius_at(angle, points[:, 2])
        deepest = (skin - np.hypot(points[:, 0], points[:, 1])).max()
        assert deepest == pytest.approx(0.006, abs=1e-5)


@pytest.mark.filterwarnings(KEPT_SHARE)
def test_it_is_smaller_where_the_patient_was_measured():
    scene, field = three_presses(), fitted().field
    found = uncertainty_map(drawn(), field, spacing=0.04)
    assert found.relative.shape == (len(found.theta), len(found.z))
    touching = scene.rows.contact_points > 0
    at = [found.at(*x) for x in scene.trajectory.position[touching]]
    behind = [found.at(-x, -y, z) for x, y, z in scene.trajectory.position[touching]]
    assert np.median(at) < 0.7 * np.median(behind)


@pytest.mark.filterwarnings(KEPT_SHARE)
def test_what_gives_no_map_is_refused(tmp_path):
    with pytest.raises(InputError, match="must be positive"):
        uncertainty_map(drawn(), fitted().field, spacing=0.0)
    with pytest.raises(InputError, match="too short"):
        uncertainty_map(drawn(), fitted().field, spacing=5.0)
    other = Voxmap.from_surface(torso(), shape=(9, 24, 10), r_inner=0.03)
    with pytest.raises(InputError, match="with another grid"):
        uncertainty_map(drawn(), PotentialField(other, other.region + 0.0, "trilinear"))
    mean = replace(fitted().field, sampling="voxel-mean")
    with pytest.raises(InputError, match="with another sampling"):
        save_with_uncertainty(mean, drawn(), tmp_path / "a.nc")
    assert not (tmp_path / "a.nc").exists()
    with pytest.raises(InputError, match="deeper than the saved draws"):
        uncertainty_map(drawn().sampled(5, 0.001), fitted().field, depth=0.06)

"""A later scan updates a surface: kept, averaged, replaced, added."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import GeometryError, InputError, TtusWarning, refuses
from tests.scan.clouds import cylinder
from ttus_opt.scan.update import update_surface

SIZE = {"n_theta": 72, "n_z": 20, "z_range": (-0.15, 0.15), "support": None}


def part(cloud, first, last):
    """Points between two angles [degrees]."""
    theta = np.rad2deg(np.arctan2(cloud[:, 1], cloud[:, 0])) % 360
    return cloud[(theta >= first) & (theta < last)]


@pytest.fixture(scope="module")
def earlier():
    cloud = part(cylinder(np.random.default_rng(0)), 0, 200)
    return tt.extract_surface(cloud, axis=tt.Axis.identity(), **SIZE)


def degrees(surface):
    return np.rad2deg(surface.theta)


def test_a_part_that_changed_and_a_part_that_is_new(earlier):
    """Later: 100° to 150° as before, 150° to 200° 20 mm further, 200° to 260° new."""
    rng = np.random.default_rng(1)
    same = part(cylinder(rng), 100, 150)
    swollen = part(cylinder(rng, radius=0.17), 150, 200)
    new = part(cylinder(rng), 200, 260)
    cloud = np.concatenate([same, swollen, new])
    found = update_surface(earlier, cloud, support=None)
    at, radius = degrees(found.surface), found.surface.radius
    early, both, changed, added = (
        (at > a) & (at < b) for a, b in ((10, 90), (105, 140), (160, 190), (205, 250))
    )
    assert np.abs(radius[early] - earlier.radius[early]).max() < 1e-3
    assert np.abs(radius[both] - 0.15).max() < 3e-3
    assert np.abs(radius[changed] - 0.17).max() < 4e-3
    assert np.abs(radius[added] - 0.15).max() < 4e-3
    assert found.surface.observed[added].all()
    assert not found.surface.observed[at > 270].any()
    assert found.kept == pytest.approx(100 / 360, abs=0.03)
    assert found.added == pytest.approx(60 / 360, abs=0.03)
    assert found.averaged == pytest.approx(50 / 360, abs=0.05)
    assert found.replaced == pytest.approx(50 / 360, abs=0.05)
    total = found.kept + found.added + found.averaged + found.replaced
    assert total == pytest.approx(found.surface.observed.mean())
    np.testing.assert_array_equal(found.surface.z, earlier.z)


def test_the_same_seen_twice_is_known_better(earlier):
    cloud = part(cylinder(np.random.default_rng(2)), 0, 200)
    found = update_surface(earlier, cloud, support=None)
    seen = earlier.observed
    assert found.averaged > 0.98 * seen.mean()
    assert abs(found.difference) < 1e-3

    def rms(surface):
        return float(np.sqrt(np.mean((surface.radius[seen] - 0.15) ** 2)))

    assert rms(found.surface) < 0.85 * rms(earlier)
    ratio = np.median(found.surface.radius_std[seen] / earlier.radius_std[seen])
    assert ratio == pytest.approx(np.sqrt(0.5), abs=0.05)


def test_a_patch_is_enough(earlier):
    """A hand's breadth of skin, 8 mm further out; the rest stays."""
    swollen = part(cylinder(np.random.default_rng(3), radius=0.158), 60, 100)
    patch = swollen[np.abs(swollen[:, 2]) < 0.05]
    found = update_surface(earlier, patch, support=None)
    inside = (np.abs(degrees(earlier) - 80) < 12)[:, None] & (np.abs(earlier.z) < 0.03)
    away = (np.abs(degrees(earlier) - 80) > 30)[:, None] & earlier.observed
    assert np.abs(found.surface.radius[inside] - 0.158).max() < 4e-3
    assert np.abs(found.surface.radius - earlier.radius)[away].max() < 1e-3
    assert found.replaced < 0.06


def test_a_patient_who_moved_is_told(earlier):
    cloud = part(cylinder(np.random.default_rng(2), radius=0.162), 0, 200)
    with pytest.warns(TtusWarning, match=r"lies \+12 mm off.*patient moved"):
        found = update_surface(earlier, cloud, support=None)
    assert found.replaced > 0.98 * earlier.observed.mean()


def test_refusals(earlier):
    cloud = part(cylinder(np.random.default_rng(2)), 0, 200)
    turned = replace(earlier, theta=earlier.theta + 0.01)
    refuses(InputError, "expected 0", update_surface, turned, cloud)
    with pytest.raises(GeometryError, match="is nowhere near the axis"):
        update_surface(earlier, cloud + np.array([2.0, 0, 0]), support=None)
    with pytest.raises(InputError, match="unit='mm'"):
        update_surface(earlier, 1000 * cloud, support=None)

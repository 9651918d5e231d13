"""Errors that depths show: attenuation of a spring, a tracker on a smooth path."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import small_scene
from ttus_opt.problem.terms.depth_map_estimate import estimate_depth_map
from ttus_opt.problem.terms.depth_regression import (
    MOST_FRAMES,
    errors_of_path,
    expected_errors,
)
from ttus_opt.problem.terms.part_noise import PartNoise, contact_directions
from ttus_opt.problem.terms.wrench import ForceTerm

#: Deviations of true depths and of their errors [m], stiffness of a spring [N/m]
TRUE, ERROR, STIFFNESS = 3e-3, 1.5e-3, 1000.0


def slope(depth, force):
    away = depth - depth.mean()
    return float(away @ force / (away @ away))


def test_a_spring_of_gaussian_depths_is_as_stiff_as_it_is():
    """Attenuated by v/(v + δ²) = 0.8 in frames that tell nothing of each other."""
    rng = np.random.default_rng(0)
    true = 0.01 + TRUE * rng.standard_normal(4 * MOST_FRAMES)
    reported = true + ERROR * rng.standard_normal(len(true))
    force, time = STIFFNESS * true, 100.0 * np.arange(len(true))
    assert slope(reported, force) == pytest.approx(0.8 * STIFFNESS, rel=0.03)
    parts = np.arange(4).repeat(MOST_FRAMES)
    found = np.concatenate(
        [
            errors_of_path(reported[parts == k], time[parts == k], ERROR)
            for k in range(4)
        ]
    )
    shifted = force + STIFFNESS * found
    assert slope(reported, shifted) == pytest.approx(STIFFNESS, rel=0.04)
    share = 0.2 * (reported - reported.mean())
    assert np.sqrt(np.mean((found - share) ** 2)) < 0.2 * share.std()


def drawn(covariance, rng):
    return np.linalg.cholesky(covariance + 1e-12 * np.eye(len(covariance))) @ (
        rng.standard_normal(len(covariance))
    )


TIME = np.arange(200) / 20.0
LAG = np.abs(TIME[:, None] - TIME)
PRESS = TRUE**2 * np.exp(-0.5 * (LAG / 0.7) ** 2)
UNREST = 5e-4**2 * np.exp(-0.5 * (LAG / 0.1) ** 2)
DRIFT, JITTER = ERROR**2 * np.exp(-LAG), 1e-3**2 * np.eye(len(LAG))


@pytest.mark.parametrize("unrest", [0.0, UNREST])
@pytest.mark.parametrize(("noise", "most"), [(DRIFT, 1.25), (JITTER, 2.0)])
def test_a_path_shows_its_errors_nearly_as_if_its_variances_were_known(
    unrest, noise, most
):
    """The mean squares left, over those of Wiener's filter; less than by one depth."""
    rng, motion = np.random.default_rng(0), PRESS + unrest
    best, off, alone = [], [], []
    for _ in range(4):
        error = drawn(noise, rng)
        depth = 0.01 + drawn(motion, rng) + error
        away, size = depth - depth.mean(), np.sqrt(noise[0, 0])
        known = noise @ np.linalg.solve(motion + noise, away)
        share = noise[0, 0] / (noise + motion)[0, 0]
        for kept, found in (
            (best, known),
            (off, errors_of_path(depth, TIME, size)),
            (alone, share * away),
        ):
            kept.append(np.mean((error - error.mean() - found + found.mean()) ** 2))
    assert np.mean(off) < most * np.mean(best)
    assert np.mean(off) < np.mean(alone)


@pytest.mark.parametrize("error", [2e-5, 1e-4])
def test_rough_motion_that_forces_follow_is_no_error(error):
    depth = drawn(PRESS + 4.0 * UNREST, np.random.default_rng(0))
    assert np.abs(errors_of_path(depth, TIME, error)).max() < 3.0 * error


@pytest.mark.parametrize("error", [1e-4, 1e-3])
def test_an_exact_path_with_kinks_has_no_errors(error):
    """A robot's, down, at rest and up; whatever errors the forces seem to show."""
    at, depth = [0.0, 2.0, 3.0, 5.0, 8.0, 10.0], [0.0, 6e-3, 6e-3, 1e-3, 9e-3, 1e-3]
    assert not errors_of_path(np.interp(TIME, at, depth), TIME, error).any()


def test_frames_beyond_the_most_follow_their_neighbours(monkeypatch):
    depth = drawn(PRESS + DRIFT, np.random.default_rng(0))
    every = errors_of_path(depth, TIME, ERROR)
    monkeypatch.setattr("ttus_opt.problem.terms.depth_regression.MOST_FRAMES", 100)
    some = errors_of_path(depth, TIME, ERROR)
    assert np.corrcoef(every, some)[0, 1] > 0.9


def test_a_fit_is_given_the_forces_of_true_depths():
    """Of the profile's slope times the error, along the contact, nothing in the air."""
    scene = small_scene("contact-size", n_poses=60)
    found = replace(estimate_depth_map(scene), depth_error=1e-3)
    noise = found.part_noise(scene)
    error = expected_errors(scene, 1e-3)
    assert np.ptp(error[scene.touching]) > 1e-4 and not error[~scene.touching].any()
    exact = replace(found, depth_error=0.0).part_noise(scene)
    assert not np.any(exact.lost)
    u = contact_directions(scene)
    moved = scene.measuring(
        replace(
            scene.trajectory,
            force=scene.f.reshape(-1, 3) + noise.lost[:, None] * u,
        )
    )
    plain = ForceTerm(moved, noise=replace(noise, lost=0.0)).assembled.target
    np.testing.assert_allclose(ForceTerm(scene, noise=noise).assembled.target, plain)
    assert isinstance(noise, PartNoise) and np.all(noise.lost * error >= 0.0)

"""Evidence against the density of a Gaussian, and what it finds of a drawn field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.distance import cdist
from scipy.stats import multivariate_normal

from tests.conftest import small_scene
from ttus_opt.errors import InputError
from ttus_opt.scene import Scene
from ttus_opt.terms import depth_map_estimate
from ttus_opt.terms.depth_map_estimate import estimate_depth_map
from ttus_opt.terms.depth_profile import voxel_depths

EXPONENTS = (1.0, 2.0)


def with_forces(scene: Scene, force: np.ndarray) -> Scene:
    return replace(
        scene, trajectory=replace(scene.trajectory, force=force.reshape(-1, 3))
    )


def drawn(seed: int, n_poses: int = 80, ratio: float = 1.0) -> Scene:
    """Forces of φ(d)(1 + g) with g drawn from the prior, and noise of 0.1 N."""
    scene = small_scene("trilinear", (9, 24, 14), n_poses, seed)
    depth = np.maximum(voxel_depths(scene.voxmap), 0.0)
    touched = np.unique(scene.N.indices)
    grid = scene.voxmap.grid
    _, j, k = np.unravel_index(touched, grid.shape)
    radius = scene.voxmap.surface.radius_at(grid.theta[j], grid.z[k])
    scale = np.array([ratio**-0.5, ratio**-0.5, ratio**0.5])
    place = scale * np.stack(
        [radius * np.cos(grid.theta[j]), radius * np.sin(grid.theta[j]), grid.z[k]], 1
    )
    down = np.abs(depth[touched, None] - depth[touched])
    prior = 0.3**2 * matern(cdist(place, place), 0.03) * matern(down, 0.015)
    rng = np.random.default_rng(seed)
    g = rng.multivariate_normal(np.zeros(len(touched)), prior, method="eigh")
    p = np.zeros(scene.n_voxels)
    p[touched] = 200.0 * depth[touched] * (1.0 + g)
    force = scene.N @ p
    return with_forces(scene, force + rng.normal(0.0, 0.1, force.shape))


def matern(distance: np.ndarray, length: float) -> np.ndarray:
    scaled = np.sqrt(3.0) * distance / length
    return (1.0 + scaled) * np.exp(-scaled)


def test_evidence_is_the_log_density_of_the_forces() -> None:
    scene = drawn(0, 40)
    problem = depth_map_estimate._Problem.of(scene, scene.N, EXPONENTS, 0.015)
    chosen = depth_map_estimate._Chosen(0.03, 0.3, 0.1, 0.05, 4.0)
    varied = np.array([1.5, 0.5])
    evidence, c = problem.evidence(chosen, varied)
    # a length of 60 mm around the patient, of 15 mm along it
    apart = np.hypot(problem.around / 0.06, problem.along / 0.015)
    prior = 0.09 * matern(apart, 1.0)[np.ix_(problem.spoke, problem.spoke)]
    prior *= problem.down
    G = (problem.rows @ sp.diags_array(problem.powers @ varied)).toarray()
    size = np.linalg.norm(problem.force.reshape(-1, 3), axis=1)
    noise = np.repeat(0.1**2 + (0.05 * size) ** 2, 3)
    cov = G @ prior @ G.T + np.diag(noise)
    expected = multivariate_normal(problem.rows @ problem.powers @ c, cov).logpdf(
        problem.force
    )
    constant = 0.5 * len(problem.force) * np.log(2.0 * np.pi)
    assert evidence == pytest.approx(expected + constant, abs=1e-6)
    # no other profile without negative coefficients makes them likelier
    rng = np.random.default_rng(6)
    for other in np.maximum(c * (1.0 + 0.01 * rng.normal(size=(9, 2))), 0.0):
        assert problem.evidence(chosen, varied, other)[0] < evidence
    assert problem.evidence(chosen, varied, c)[0] == pytest.approx(evidence)


@pytest.mark.parametrize(
    ("deviation", "first", "best"), [(0.3, (0.0, 1e3), 2), (1.0, (20.0, 0.0), 1)]
)
def test_of_the_rounds_of_a_profile_the_likeliest_counts(
    deviation: float, first: tuple[float, float], best: int
) -> None:
    """Each begins with what the last one found; it may be no better."""
    scene = drawn(0, 40)
    problem = depth_map_estimate._Problem.of(scene, scene.N, EXPONENTS, 0.015)
    chosen = depth_map_estimate._Chosen(0.03, deviation, 0.1, 0.05, 1.0)
    rounds = [np.array(first)]
    for _ in range(2):
        rounds.append(problem.evidence(chosen, rounds[-1])[1])
    own = [problem.evidence(chosen, c, c)[0] for c in rounds]
    assert max(own) == own[best] and own[best] > 1.0 + own[best - 1]
    np.testing.assert_array_equal(problem.profile(chosen, rounds[0]), rounds[best])


def test_noise_is_never_less_than_a_covariance_needs() -> None:
    scene = drawn(0, 40)
    problem = depth_map_estimate._Problem.of(scene, scene.N, EXPONENTS, 0.015)
    silent = depth_map_estimate._Chosen(0.03, 0.3, 1e-9, 1e-9, 1.0)
    rms = np.sqrt((problem.force**2).sum() / (len(problem.force) / 3))
    np.testing.assert_allclose(np.sqrt(problem.variances(silent)), 1e-4 * rms)


def test_it_finds_profile_and_noise_of_drawn_fields() -> None:
    scene = drawn(3)
    found = estimate_depth_map(scene, exponents=EXPONENTS)
    assert found.noise == pytest.approx(0.1, rel=0.2)
    depth = np.array([0.004])
    assert found.profile(depth)[0] == pytest.approx(0.8, rel=0.25)
    assert 0.15 < found.deviation < 0.6


@pytest.mark.parametrize("ratio", [16.0, 1.0 / 16.0])
def test_it_finds_in_which_direction_a_drawn_field_varies(ratio: float) -> None:
    found = estimate_depth_map(drawn(3, ratio=ratio), exponents=EXPONENTS)
    assert abs(np.log(found.length_ratio / ratio)) < np.log(4.0)


def test_noise_that_grows_with_the_force_is_not_taken_for_tissue() -> None:
    scene = drawn(4)
    rng = np.random.default_rng(4)
    size = np.linalg.norm(scene.f.reshape(-1, 3), axis=1)
    own = np.repeat(0.3 * size, 3) * rng.standard_normal(scene.f.shape)
    found = estimate_depth_map(with_forces(scene, scene.f + own), exponents=EXPONENTS)
    assert found.noise == pytest.approx(
        np.hypot(0.1, 0.3 * np.sqrt(np.mean(size**2))), rel=0.3
    )


def test_forces_that_pull_and_none_at_all_are_refused() -> None:
    scene = drawn(0, 20)
    with pytest.raises(InputError, match="pull the probe in"):
        estimate_depth_map(with_forces(scene, -scene.f), exponents=EXPONENTS)
    with pytest.raises(InputError, match="never touches"):
        estimate_depth_map(with_forces(scene, 0.0 * scene.f), exponents=EXPONENTS)

"""Evidence against the density of a Gaussian, and what it finds of a drawn field."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.distance import cdist
from scipy.stats import multivariate_normal

from tests.conftest import small_scene
from ttus_opt.contact.rows import contact_rows
from ttus_opt.errors import InputError, TtusWarning
from ttus_opt.scene import Scene
from ttus_opt.terms import depth_map_estimate
from ttus_opt.terms.depth_map_estimate import _Chosen, _Problem, estimate_depth_map
from ttus_opt.terms.depth_profile import EXPONENTS as POWERS
from ttus_opt.terms.depth_profile import voxel_depths
from ttus_opt.terms.posterior_mode import PosteriorMode

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


def dense(scene: Scene, chosen: _Chosen, varied: np.ndarray, c: np.ndarray) -> float:
    """Log density of the forces of frames in contact, voxel by voxel.

    Args:
        scene: With measured forces.
        chosen: Hyperparameters.
        varied: Coefficients of the profile that varies.
        c: Of the mean.
    """
    size = np.linalg.norm(scene.f.reshape(-1, 3), axis=1)
    frames = np.flatnonzero((scene.rows.contact_points > 0) & (size > 0.1))
    rows = np.ravel(3 * frames[:, None] + np.arange(3))
    grid, N = scene.voxmap.grid, scene.N.toarray()[rows]
    depth = voxel_depths(scene.voxmap)
    _, j, k = np.unravel_index(np.arange(scene.n_voxels), grid.shape)
    radius = scene.voxmap.surface.radius_at(grid.theta[j], grid.z[k])
    place = radius[:, None] * np.stack([np.cos(grid.theta[j]), np.sin(grid.theta[j])]).T
    touched = np.flatnonzero(N.any(axis=0))
    place, z, d = place[touched], grid.z[k[touched], None], depth[touched, None]
    root = np.sqrt(chosen.length_ratio)
    apart = np.hypot(cdist(place, place) / root, root * cdist(z, z))
    prior = matern(apart, chosen.surface_length) * matern(cdist(d, d), 0.015)
    powers = np.maximum(d / 0.01, 0.0) ** np.array(EXPONENTS)
    G = N[:, touched] * (powers @ varied)
    noise = chosen.noise**2 + (chosen.relative_noise * size[frames]) ** 2
    cov = chosen.deviation**2 * G @ prior @ G.T + np.diag(np.repeat(noise, 3))
    mean = N[:, touched] @ powers @ c
    density = multivariate_normal(mean, cov).logpdf(scene.f[rows])
    return float(density) + 0.5 * len(rows) * np.log(2.0 * np.pi)


def test_evidence_is_the_log_density_of_the_forces() -> None:
    scene = drawn(0, 40)
    problem = _Problem.of(scene, scene.N, EXPONENTS, 0.015)
    chosen = _Chosen(0.03, 0.3, 0.1, 0.05, 4.0)
    varied = np.array([1.5, 0.5])
    evidence, c = problem.evidence(chosen, varied)
    assert evidence == pytest.approx(dense(scene, chosen, varied, c), abs=1e-6)
    # no other profile without negative coefficients makes them likelier
    rng = np.random.default_rng(6)
    for other in np.maximum(c * (1.0 + 0.01 * rng.normal(size=(9, 2))), 0.0):
        assert problem.evidence(chosen, varied, other)[0] < evidence
    assert problem.evidence(chosen, varied, c)[0] == pytest.approx(evidence)


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0, 3.0])
def test_each_of_the_powers_alone_explains_a_field_that_grows_with_it(
    power: float,
) -> None:
    """A stiff layer, a round tip on a half-space, tissue that stiffens."""
    scene = drawn(0, 40)
    p = 0.7 * np.maximum(voxel_depths(scene.voxmap) / 0.01, 0.0) ** power
    grown = with_forces(scene, scene.N @ p)
    found = _Problem.of(grown, scene.N, POWERS, 0.015).least_squares()
    expected = 0.7 * (np.array(POWERS) == power)
    assert expected.any()
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_the_posterior_has_the_priors_of_the_method(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Medians and factors as in docs/method.md, (8.15); starts at other ratios."""
    asked = []

    def climbed(evidence: Any, n: int, calls: int, starts: Any) -> PosteriorMode:
        asked.append((evidence, n, starts))
        return PosteriorMode(np.zeros(n), 0.0)

    monkeypatch.setattr(depth_map_estimate, "posterior_mode", climbed)
    scene = drawn(0, 40)
    found = estimate_depth_map(scene, exponents=EXPONENTS)
    medians = _Chosen(0.03, 0.4, 0.05, 0.03, 1.0)
    assert (found.surface_length, found.deviation, found.length_ratio) == pytest.approx(
        (0.03, 0.4, 1.0)
    )
    size = np.linalg.norm(scene.f.reshape(-1, 3), axis=1)
    size = size[(scene.rows.contact_points > 0) & (size > 0.1)]
    noise = np.sqrt(np.mean(0.05**2 + (0.03 * size) ** 2))
    assert found.noise == pytest.approx(noise)
    evidence, n, starts = asked[0]
    assert n == 5
    problem = _Problem.of(scene, scene.N, EXPONENTS, 0.015)
    first = problem.profile(medians, problem.least_squares())
    factors = np.exp([0.3, 1.0, 1.0, 0.7, 1.0])
    for steps in (np.zeros(5), *np.eye(5), *-np.eye(5)):
        chosen = _Chosen(*np.multiply(medians, factors**steps))
        _, c = problem.evidence(chosen, first)
        assert evidence(steps) == pytest.approx(dense(scene, chosen, first, c))
    ratios = [1.0 * factors[4] ** start[4] for start in starts]
    assert ratios == pytest.approx([0.1, 10.0])
    assert not np.any([start[:4] for start in starts])


def test_a_field_of_another_unit_has_the_profile_of_another_unit() -> None:
    """Rows twice as large are those of a field half as large; all else stays."""
    scene = drawn(3, 40)
    one = estimate_depth_map(scene, exponents=EXPONENTS)
    rows = sp.csr_array(2.0 * scene.N)
    two = estimate_depth_map(scene, rows, exponents=EXPONENTS)
    assert one.profile.coefficients == pytest.approx(
        [2.0 * c for c in two.profile.coefficients]
    )
    for name in ("deviation", "surface_length", "noise", "length_ratio"):
        assert getattr(one, name) == pytest.approx(getattr(two, name))
    assert two.depth_length == 0.015


def lifted(scene: Scene, frame: int, points: int) -> Scene:
    """A frame's probe lifted off until so many of its points are in contact."""
    trajectory = scene.trajectory
    up = trajectory.position[frame] * [1.0, 1.0, 0.0]
    lifts = np.linspace(0.0, 0.03, 600)[:, None] * up / np.linalg.norm(up)
    turned = np.tile(trajectory.rotation[frame], (len(lifts), 1, 1))
    places = trajectory.position[frame] + lifts
    rows = contact_rows(scene.voxmap, scene.shell, turned, places)
    position = trajectory.position.copy()
    position[frame] = places[np.flatnonzero(rows.contact_points == points)[0]]
    given = {"inner": 2.0, "outer": 1.5, "sampling": "trilinear"}
    moved = replace(trajectory, position=position)
    return Scene.assemble(scene.voxmap, scene.shell, moved, **given)


def test_frames_without_contact_or_force_do_not_count() -> None:
    """Nothing of the air, nor below 0.1 N; 0.11 N counts, and a single point."""
    scene = lifted(lifted(drawn(0, 40), 0, 0), 1, 1)
    force = scene.f.reshape(-1, 3) / np.linalg.norm(
        scene.f.reshape(-1, 3), axis=1, keepdims=True
    )
    force[2:5] *= 0.09
    force[5:8] *= 0.11
    problem = _Problem.of(with_forces(scene, force), scene.N, EXPONENTS, 0.015)
    np.testing.assert_array_equal(problem.force, force[[1, *range(5, 40)]].ravel())


@pytest.mark.parametrize(
    ("most", "step"), [(200, 1), (40, 1), (39, 2), (20, 2), (19, 3), (1, 40)]
)
def test_many_frames_are_thinned_evenly(
    most: int, step: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No more than are asked for, by the least step that does it."""
    monkeypatch.setattr(depth_map_estimate, "MOST_FRAMES", most)
    scene = drawn(0, 40)
    force = scene.f.reshape(-1, 3)
    assert (np.linalg.norm(force, axis=1) > 0.1).all()
    assert (scene.rows.contact_points > 0).all()
    kept = _Problem.of(scene, scene.N, EXPONENTS, 0.015).force.reshape(-1, 3)
    assert len(kept) <= most
    np.testing.assert_array_equal(kept, force[::step])


def test_where_variation_alone_explains_the_forces_a_profile_is_kept() -> None:
    """Forces that pull are those of no profile that grows with depth."""
    scene = drawn(0, 40)
    pulling = with_forces(scene, -scene.f)
    problem = _Problem.of(pulling, scene.N, EXPONENTS, 0.015)
    chosen, varied = _Chosen(0.03, 0.3, 0.1, 0.05, 1.0), np.array([1.5, 0.5])
    evidence, c = problem.evidence(chosen, varied)
    np.testing.assert_array_equal(c, varied)
    assert evidence == pytest.approx(dense(pulling, chosen, varied, varied), abs=1e-6)


@pytest.mark.parametrize(
    ("deviation", "first", "best"), [(0.3, (0.0, 1e3), 2), (1.0, (20.0, 0.0), 1)]
)
def test_of_the_rounds_of_a_profile_the_likeliest_counts(
    deviation: float, first: tuple[float, float], best: int
) -> None:
    """Each begins with what the last one found; it may be no better."""
    scene = drawn(0, 40)
    problem = _Problem.of(scene, scene.N, EXPONENTS, 0.015)
    chosen = _Chosen(0.03, deviation, 0.1, 0.05, 1.0)
    rounds = [np.array(first)]
    for _ in range(2):
        rounds.append(problem.evidence(chosen, rounds[-1])[1])
    own = [problem.evidence(chosen, c, c)[0] for c in rounds]
    assert max(own) == own[best] and own[best] > 1.0 + own[best - 1]
    np.testing.assert_array_equal(problem.profile(chosen, rounds[0]), rounds[best])


def test_noise_is_never_less_than_a_covariance_needs() -> None:
    scene = drawn(0, 40)
    problem = _Problem.of(scene, scene.N, EXPONENTS, 0.015)
    silent = _Chosen(0.03, 0.3, 1e-9, 1e-9, 1.0)
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
    with pytest.raises(InputError, match="touches they reach 0 N only"):
        estimate_depth_map(with_forces(scene, 0.0 * scene.f), exponents=EXPONENTS)
    away = replace(scene.trajectory, position=[1.2, 1.2, 1] * scene.trajectory.position)
    with pytest.warns(TtusWarning, match="touches the patient in none"):
        apart = Scene.assemble(scene.voxmap, scene.shell, away, inner=1.0)
    with pytest.raises(InputError, match="never touches"):
        estimate_depth_map(apart, exponents=EXPONENTS)

"""Evidence against the density of a Gaussian, and what it finds of a drawn field."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.distance import cdist
from scipy.stats import multivariate_normal

from tests.kit import InputError, TtusWarning, refuses, small_scene, with_wrenches
from ttus_opt.contact.scene import Scene
from ttus_opt.gaussian.posterior_mode import PosteriorMode
from ttus_opt.problem.terms import depth_map_estimate
from ttus_opt.problem.terms.depth_map_estimate import (
    Hyperparameters,
    _coarser,
    _Problem,
    estimate_depth_map,
    least_squares_profile,
)
from ttus_opt.problem.terms.depth_profile import voxel_depths
from ttus_opt.problem.terms.part_noise import PartNoise, contact_directions
from ttus_opt.voxmap.sampling import sized


def drawn(seed, n_poses=80, ratio=1.0):
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
    return with_wrenches(scene, force + rng.normal(0.0, 0.1, force.shape))


def matern(distance, length):
    scaled = np.sqrt(3.0) * distance / length
    return (1.0 + scaled) * np.exp(-scaled)


CHOSEN = Hyperparameters(1.2, 0.03, 0.3, 0.015, 0.1, 0.05, 1.5, 0.04, 3e-4)


def dense(scene, chosen):
    """Log density of the normal forces of frames in contact, voxel by voxel."""
    frames = np.flatnonzero(scene.rows.contact_points > 0)
    depth = np.maximum(voxel_depths(scene.voxmap), 0.0)
    lever = (scene.N @ depth).reshape(-1, 3)[frames]
    u = lever / np.linalg.norm(lever, axis=1, keepdims=True)
    N = scene.N.toarray().reshape(-1, 3, scene.n_voxels)[frames]
    N = np.einsum("ti,tiv->tv", u, N)
    f = np.einsum("ti,ti->t", u, scene.f.reshape(-1, 3)[frames])
    grid = scene.voxmap.grid
    touched = np.flatnonzero(N.any(axis=0))
    _, j, k = np.unravel_index(touched, grid.shape)
    radius = scene.voxmap.surface.radius_at(grid.theta[j], grid.z[k])
    place = np.stack(
        [radius * np.cos(grid.theta[j]), radius * np.sin(grid.theta[j]), grid.z[k]], 1
    )
    d = depth[touched, None]
    stretched = np.sqrt(chosen.length_ratio) ** np.array([-1.0, -1.0, 1.0]) * place
    prior = matern(cdist(stretched, stretched), chosen.surface_length)
    prior *= matern(cdist(d, d), chosen.depth_length)
    per_depth = chosen.exponent / np.maximum(d[:, 0], 5e-4)
    N = N[:, touched] * (d[:, 0] / 0.01) ** chosen.exponent
    G = N.sum(axis=1)
    c = (G @ f) / (G @ G)
    mean, scale, slope = c * G, chosen.deviation * c, c * N @ per_depth
    at = scene.trajectory.position[frames]
    same = (np.diff(frames) == 1) & (np.diff(scene.trajectory.segment[frames]) == 0)
    press = np.concatenate([[0], np.cumsum(~same)])
    shared = matern(cdist(at, at), 0.005) * (press[:, None] == press)
    cov = scale**2 * N @ prior @ N.T + chosen.shared_error**2 * shared * np.outer(
        mean, mean
    )
    time, recording = scene.trajectory.time[frames], scene.trajectory.segment[frames]
    late = np.exp(-np.abs(time[:, None] - time)) * (recording[:, None] == recording)
    cov += chosen.depth_error**2 * late * np.outer(slope, slope)
    cov += np.diag(chosen.sensor_noise**2 + (chosen.relative_noise * mean) ** 2)
    density = multivariate_normal(mean, cov).logpdf(f)
    return float(density) + 0.5 * len(f) * np.log(2.0 * np.pi)


def test_evidence_is_the_log_density_of_the_normal_forces(monkeypatch):
    scene = drawn(0, 40)
    exact = dense(scene, CHOSEN)
    assert _Problem.of(scene, scene.N).evidence(CHOSEN) == pytest.approx(exact, abs=0.2)
    monkeypatch.setattr(depth_map_estimate, "LEAST_EIGENVALUE", 1e-9)
    monkeypatch.setattr(depth_map_estimate, "DEPTHS", 400)
    found = _Problem.of(scene, scene.N).evidence(CHOSEN)
    assert found == pytest.approx(exact, abs=2e-3)


def test_fewer_nodes_tell_nearly_the_same(monkeypatch):
    """A bilinear interpolation, whose weights are 1 and which leaves planes alone."""
    scene, smooth = drawn(0, 40), replace(CHOSEN, surface_length=0.15, sensor_noise=1.0)
    exact = dense(scene, smooth)
    off = []
    for most in (20, 60):
        monkeypatch.setattr(depth_map_estimate, "MOST_NODES", most)
        problem = _Problem.of(scene, scene.N)
        assert problem.nodes.shape[1] <= most < problem.nodes.shape[0]
        off.append(abs(problem.evidence(smooth) - exact))
    assert off[1] < 1.0 < 2.0 < off[0], off
    grid = scene.voxmap.grid
    n_theta, n_z = grid.shape[1:]
    spokes = np.arange(n_theta * n_z)
    nodes, weights = _coarser(spokes, grid)
    assert len(nodes) <= 60
    np.testing.assert_allclose(weights @ np.ones(len(nodes)), 1.0)
    np.testing.assert_allclose(weights @ (nodes % n_z), spokes % n_z, atol=1e-12)
    inner = spokes // n_z <= nodes.max() // n_z  # beyond, the angle starts again
    np.testing.assert_allclose(
        (weights @ (nodes // n_z))[inner], (spokes // n_z)[inner], atol=1e-12
    )


@pytest.mark.parametrize("power", [1.0, 1.5, 2.0, 3.0])
def test_each_of_the_powers_alone_explains_a_field_that_grows_with_it(power):
    """A stiff layer, a round tip on a half-space, tissue that stiffens."""
    scene = drawn(0, 40)
    p = 0.7 * np.maximum(voxel_depths(scene.voxmap) / 0.01, 0.0) ** power
    grown = with_wrenches(scene, scene.N @ p)
    found = least_squares_profile(grown)
    expected = 0.7 * (np.array(found.exponents) == power)
    assert expected.any()
    np.testing.assert_allclose(found.coefficients, expected, atol=1e-6)
    c, mean = _Problem.of(grown, grown.N).mean(Hyperparameters(power))
    assert c == pytest.approx(0.7)
    np.testing.assert_allclose(mean, _Problem.of(grown, grown.N).force, rtol=1e-9)


def test_the_posterior_has_the_priors_of_the_method(monkeypatch):
    """Medians and factors as in docs/method/formulations.md, (8.15)."""
    asked = []

    def climbed(evidence, n, calls):
        asked.append((evidence, n))
        return PosteriorMode(np.zeros(n), 0.0)

    monkeypatch.setattr(depth_map_estimate, "posterior_mode", climbed)
    scene = drawn(0, 40)
    found = estimate_depth_map(scene)
    medians = np.array(
        [1.3, 2.6 * scene.shell.rms_radius, 0.4, 0.01, 0.05, 0.03, 1.0, 0.03, 1e-4]
    )
    factors = np.exp([0.2, 0.2, 0.7, 0.5, 1.0, 1.0, 0.5, 0.7, 1.0])
    assert found.profile.exponents == (1.3,)
    assert found.surface_length == pytest.approx(medians[1])
    assert (found.deviation, found.depth_length) == pytest.approx((0.4, 0.01))
    mean = _Problem.of(scene, scene.N).mean(Hyperparameters(1.3))[1]
    noise = np.sqrt(2.0 * np.mean(0.05**2 + (0.03 * mean) ** 2))
    assert found.noise == pytest.approx(noise)
    (evidence, n), problem = asked[0], _Problem.of(scene, scene.N)
    assert n == 9
    for steps in (np.zeros(9), *np.eye(9)):
        values = medians * factors**steps
        values[4:6] = np.hypot([0.05, 0.03], values[4:6])
        chosen = Hyperparameters(*values)
        assert evidence(steps) == pytest.approx(problem.evidence(chosen))
    estimate_depth_map(scene, depth_length=0.02)
    assert asked[1][1] == 8
    exact = estimate_depth_map(scene, depth_error=0.0)
    assert asked[2][1] == 8 and exact.depth_error == 0.0


@pytest.mark.parametrize(
    ("name", "value"),
    [("deviation", 0.7), ("surface_length", 0.05), ("length_ratio", 0.5)],
)
def test_what_is_given_is_not_estimated(name, value):
    """It keeps its value, where the evidence would have another one."""
    scene = drawn(0, 40)
    found = estimate_depth_map(scene, **{name: value})
    assert getattr(found, name) == value
    assert getattr(estimate_depth_map(scene), name) != pytest.approx(value, rel=0.1)
    with pytest.raises(InputError, match=f"{name} must lie between .*, got -1.0"):
        estimate_depth_map(scene, **{name: -1.0})


@pytest.mark.parametrize("sampling", ["trilinear", "contact-size", "contact-size:0.04"])
def test_another_length_of_contacts_is_another_assembly(sampling):
    """Whatever the rows, evidence and coefficient are those of rows with ℓ₀."""
    scene, chosen = (
        drawn(0, 40).resampled(sampling),
        replace(CHOSEN, least_length=0.02),
    )
    other = scene.resampled("contact-size:0.02")
    problem = _Problem.of(scene, scene.N)
    expected = _Problem.of(other, other.N)
    assert problem.mean(chosen)[0] == pytest.approx(expected.mean(CHOSEN)[0])
    assert problem.evidence(chosen) == pytest.approx(expected.evidence(CHOSEN))
    assert problem.evidence(CHOSEN) != pytest.approx(expected.evidence(CHOSEN), abs=0.1)


def test_it_finds_the_length_of_contacts_that_forces_have():
    """Forces of a field sampled with ℓ₀ of 4 mm and 40 mm, about a probe of 20 mm."""
    found = []
    for least in ("0.004", "0.04"):
        scene = drawn(3).resampled(f"contact-size:{least}")
        depth = np.maximum(voxel_depths(scene.voxmap), 0.0)
        noise = np.random.default_rng(1).normal(0.0, 0.02, len(scene.f))
        pressed = with_wrenches(scene, scene.N @ (400.0 * depth) + noise)
        found.append(estimate_depth_map(pressed, resampled=True))
        again = pressed.resampled(sized(found[-1].least_length))
        same = estimate_depth_map(again)
        assert same.profile(0.01) == pytest.approx(found[-1].profile(0.01), rel=0.02)
        assert same.least_length == 0.0
    assert 0.002 < found[0].least_length < 0.008
    assert 0.025 < found[1].least_length < 0.06


def test_a_field_of_another_unit_has_the_profile_of_another_unit():
    """Rows twice as large are those of a field half as large; all else stays."""
    scene = drawn(3, 40)
    one = estimate_depth_map(scene, depth_length=0.015)
    rows = sp.csr_array(2.0 * scene.N)
    two = estimate_depth_map(scene, rows, depth_length=0.015)
    assert one.profile.coefficients == pytest.approx(
        [2.0 * c for c in two.profile.coefficients]
    )
    for name in ("deviation", "surface_length", "noise"):
        assert getattr(one, name) == pytest.approx(getattr(two, name))
    assert two.depth_length == 0.015


def lifted(scene, frame):
    """A frame's probe lifted off the patient."""
    trajectory = scene.trajectory
    position = trajectory.position.copy()
    position[frame] *= [1.3, 1.3, 1.0]
    given = {"inner": 2.0, "outer": 1.5, "sampling": "trilinear"}
    moved = replace(trajectory, position=position)
    return Scene.assemble(scene.voxmap, scene.shell, moved, **given)


def test_frames_in_the_air_do_not_count():
    scene = drawn(0, 40)
    whole = _Problem.of(scene, scene.N).force
    away = lifted(scene, 0)
    kept = _Problem.of(with_wrenches(away, scene.f), away.N).force
    np.testing.assert_allclose(kept, whole[1:])


@pytest.mark.parametrize(
    ("most", "step"), [(200, 1), (40, 1), (39, 2), (20, 2), (19, 3), (1, 40)]
)
def test_many_frames_are_thinned_evenly(most, step, monkeypatch):
    """No more than are asked for, by the least step that does it."""
    scene = drawn(0, 40)
    assert (scene.rows.contact_points > 0).all()
    whole = _Problem.of(scene, scene.N).force
    monkeypatch.setattr(depth_map_estimate, "MOST_FRAMES", most)
    kept = _Problem.of(scene, scene.N).force
    assert len(kept) <= most
    np.testing.assert_allclose(kept, whole[::step])


def test_further_errors_count_along_the_contact_alone():
    """A large variance across it changes nothing, along it the evidence of the rest."""
    scene = drawn(0, 40)
    u = contact_directions(scene)
    plain = _Problem.of(scene, scene.N).evidence(CHOSEN)

    def covariance(blocks):
        def of(frames):
            out = np.zeros((3 * len(frames),) * 2)
            for k, t in enumerate(frames):
                out[3 * k : 3 * k + 3, 3 * k : 3 * k + 3] = blocks[t]
            return out

        return of

    along = u[:, :, None] * u[:, None, :]
    across = _Problem.of(scene, scene.N, errors=covariance(100.0 * (np.eye(3) - along)))
    assert across.evidence(CHOSEN) == pytest.approx(plain, abs=1e-6)
    more = _Problem.of(scene, scene.N, errors=covariance(0.1**2 * along))
    noisier = replace(CHOSEN, sensor_noise=float(np.hypot(CHOSEN.sensor_noise, 0.1)))
    expected = _Problem.of(scene, scene.N).evidence(noisier)
    assert more.evidence(CHOSEN) == pytest.approx(expected, abs=1e-9)


def test_noise_is_never_less_than_a_covariance_needs():
    scene = drawn(0, 40)
    problem = _Problem.of(scene, scene.N)
    silent = replace(CHOSEN, sensor_noise=1e-9, relative_noise=1e-9)
    rms = np.sqrt(np.mean(problem.force**2))
    _, mean = problem.mean(Hyperparameters(1.2))
    np.testing.assert_allclose(np.sqrt(problem.variances(silent, mean)), 1e-4 * rms)


def test_it_finds_profile_and_noise_of_drawn_fields():
    scene = drawn(3)
    found = estimate_depth_map(scene)
    _, mean = _Problem.of(scene, scene.N).mean(found)
    expected = np.hypot(0.1, 0.03 * np.sqrt(np.mean(mean**2)))
    assert found.noise == pytest.approx(expected, rel=0.3)
    depth = np.array([0.004])
    assert found.profile(depth)[0] == pytest.approx(0.8, rel=0.25)
    assert 0.15 < found.deviation < 0.6
    own = replace(found, depth_error=0.0).part_noise(scene)
    assert own.level == pytest.approx(found.noise, rel=0.05)


def test_the_fit_has_the_noise_and_the_depth_error_of_the_evidence():
    scene = drawn(0, 30)
    found = replace(estimate_depth_map(scene), depth_error=5e-4, relative_noise=0.1)
    depth = np.maximum(voxel_depths(scene.voxmap), 0.0)
    u = contact_directions(scene)

    def normal(p):
        return np.asarray(np.einsum("ti,ti->t", u, (scene.N @ p).reshape(-1, 3)))

    force = normal(found.profile(depth))
    deeper = normal(found.profile(np.where(depth > 0.0, depth + 1e-7, 0.0)))
    drift = (deeper - force) / 1e-7 * 5e-4
    own = np.hypot(found.sensor_noise, 0.1 * force)
    expected = PartNoise.of(scene, own, force, drift)
    noise = found.part_noise(scene)
    assert noise.level == pytest.approx(expected.level, rel=1e-2)
    np.testing.assert_allclose(noise.across, expected.across, rtol=1e-2)
    left = abs(noise.normal - expected.normal).max() / abs(expected.normal).max()
    assert left < 0.02 and noise.normal.nnz > len(u)


@pytest.mark.parametrize("ratio", [16.0, 1.0 / 16.0])
def test_it_finds_in_which_direction_a_drawn_field_varies(ratio):
    found = estimate_depth_map(drawn(3, ratio=ratio))
    assert np.log(found.length_ratio) * np.log(ratio) > 0.5 * np.log(16.0)


def test_a_trackers_error_is_not_taken_for_tissue():
    """Depths that are wrong by 0.5 mm for a second, which 20 frames share."""
    scene = drawn(3, 120)
    step = np.random.default_rng(6).standard_normal(120)
    wrong = np.zeros(120)
    kept = np.exp(-0.05)
    for t in range(1, 120):
        wrong[t] = kept * wrong[t - 1] + np.sqrt(1.0 - kept**2) * step[t]
    slope = (scene.N @ (200.0 * (voxel_depths(scene.voxmap) > 0.0))).reshape(-1, 3)
    off = (5e-4 * wrong[:, None] * slope).ravel()
    assert np.sqrt(np.mean(off**2)) > 0.05
    time = replace(scene.trajectory, time=0.05 * np.arange(120))
    exact = estimate_depth_map(replace(scene, trajectory=time))
    moved = estimate_depth_map(
        replace(
            with_wrenches(scene, scene.f + off),
            trajectory=replace(time, force=(scene.f + off).reshape(-1, 3)),
        )
    )
    assert exact.depth_error < 2e-4 < 3e-4 < moved.depth_error < 1e-3


def test_forces_that_pull_and_none_at_all_are_refused():
    scene = drawn(0, 20)
    for estimate in (estimate_depth_map, least_squares_profile):
        refuses(
            InputError, "pull the probe in", estimate, with_wrenches(scene, -scene.f)
        )
        with pytest.raises(InputError, match="touches they reach 0 N only"):
            estimate(with_wrenches(scene, 0.0 * scene.f))
    away = replace(scene.trajectory, position=[1.2, 1.2, 1] * scene.trajectory.position)
    with pytest.warns(TtusWarning, match="touches the patient in none"):
        apart = Scene.assemble(scene.voxmap, scene.shell, away, inner=1.0)
    refuses(InputError, "never touches", estimate_depth_map, apart)


def test_the_covariance_is_formed_once_for_values_that_do_not_enter_it(monkeypatch):
    scene = drawn(0, 40)
    problem = _Problem.of(scene, scene.N)
    lengths, formed = [], depth_map_estimate.matern

    def counted(distance, length):
        lengths.append(length)
        return formed(distance, length)

    monkeypatch.setattr(depth_map_estimate, "matern", counted)
    for changes in (
        {},
        {"deviation": 0.5},
        {"sensor_noise": 0.2},
        {"shared_error": 0.1},
    ):
        again = replace(CHOSEN, **changes)
        fresh = _Problem.of(scene, scene.N).evidence(again)
        lengths.clear()
        assert problem.evidence(again) == fresh
        assert len(lengths) == (0 if changes else 2)  # along the skin, in depth
    problem.evidence(replace(CHOSEN, surface_length=0.04))
    assert lengths == [0.04]

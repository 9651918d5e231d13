"""A step against Gaussian conditioning by dense matrices of all voxels."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.fitting.pose_error_step import PROFILE_SPREAD, PoseErrorProblem, State
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.scene import Scene
from ttus_opt.terms.depth_map import voxel_profile
from ttus_opt.terms.depth_map_estimate import DepthMapEstimate
from ttus_opt.terms.depth_profile import DepthProfile, voxel_depths
from ttus_opt.terms.matern import SeparableCovariance

NOISE = TrackerNoise(4e-4, 0.01, 0.2)
MAP = DepthMapEstimate(
    DepthProfile((1.0, 2.0), (1.0, 0.5)),
    *(0.3, 0.03, 0.015, 0.1, 0.0),
    length_ratio=2.0,
    sensor_noise=0.05,
    relative_noise=0.04,
)


@cache
def pressed() -> Scene:
    """Forces of a field that varies along the patient, with noise."""
    scene = small_scene("trilinear", (9, 20, 10), 16, 3)
    z = np.broadcast_to(scene.voxmap.grid.z, scene.voxmap.grid.shape).ravel()
    depth = voxel_depths(scene.voxmap)
    force = scene.N @ (150.0 * depth * (1.0 + 0.3 * np.sin(z / 0.02)))
    force += np.random.default_rng(0).normal(0.0, 0.05, force.shape)
    own = replace(scene.trajectory, force=force.reshape(-1, 3))
    return replace(scene, trajectory=own)


def problem(friction: float = 0.2) -> PoseErrorProblem:
    return PoseErrorProblem.of(pressed(), NOISE, friction)


def latest(of: PoseErrorProblem) -> State:
    rng = np.random.default_rng(1)
    xi = 0.3 * rng.standard_normal((len(of.alike), 6))
    p = voxel_profile(of.scene, MAP.profile) * (1.0 + 0.05 * rng.standard_normal())
    return State(xi, np.zeros_like(xi), p, MAP)


def dense_prior(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    """Mean and covariance of the field, of all voxels."""
    mean = voxel_profile(scene, MAP.profile)
    lengths = MAP.surface_length, MAP.depth_length, MAP.length_ratio
    covariance = SeparableCovariance.over(scene.voxmap, MAP.deviation * mean, *lengths)
    rows = covariance.rows.toarray()
    dense = np.linalg.inv(rows.T @ rows)
    return mean, dense + PROFILE_SPREAD**2 * np.outer(mean, mean)


def test_a_step_is_gaussian_conditioning(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("ttus_opt.fitting.pose_error_step.AT_ONCE", 5)
    of = problem()
    last, scene = latest(of), of.scene
    found = of.step(last, estimate=False)

    own, k = scene.trajectory, of.frames
    assert len(k) > 7
    poses = NOISE.moved(own.rotation, own.position, -last.xi)
    at = np.ravel(3 * k[:, None] + np.arange(3))
    D = of.rows.at(*poses).toarray()[at]
    changes = [c.toarray()[at] for c in of.rows.derivatives(*poses, NOISE)]
    size = np.linalg.norm(scene.f.reshape(-1, 3)[k], axis=1)
    sensor = np.diag(np.repeat(0.05**2 + (0.04 * size) ** 2, 3))
    mean, C = dense_prior(scene)

    # J of all ξ, frame by frame, and their prior covariance
    T = len(own)
    J = np.zeros((len(at), 6 * T))
    for i, frame in enumerate(k):
        for j, change in enumerate(changes):
            J[3 * i : 3 * i + 3, 6 * frame + j] = (change @ last.p)[3 * i : 3 * i + 3]
    apart = np.abs(own.time[:, None] - own.time)
    K = np.kron(np.exp(-apart / 0.2), np.eye(6))

    # b by finite differences of the determinant
    touched = np.any([each.any(axis=0) for each in (D, *changes)], axis=0)
    few = C[np.ix_(touched, touched)]

    def half_log_det(frame: int, j: int, xi: float) -> float:
        moved = D.copy()
        rows = slice(3 * frame, 3 * frame + 3)
        moved[rows] -= xi * changes[j][rows]
        moved = moved[:, touched]
        return 0.5 * float(np.linalg.slogdet(sensor + moved @ few @ moved.T)[1])

    b = np.zeros((T, 6))
    for i, frame in enumerate(k):
        for j in range(6):
            rise = half_log_det(i, j, 1e-4) - half_log_det(i, j, -1e-4)
            b[frame, j] = -rise / 2e-4
    assert np.abs(b).max() > 0.01

    y = scene.f[at] - J @ last.xi.ravel()
    S = D @ C @ D.T + J @ K @ J.T + sensor
    expected = K @ b.ravel()
    misfit = y - D @ mean + J @ expected
    xi = expected - K @ J.T @ np.linalg.solve(S, misfit)
    covariance = K - K @ J.T @ np.linalg.solve(S, J @ K)
    p = mean + C @ D.T @ np.linalg.solve(S, misfit)
    np.testing.assert_allclose(found.xi, xi.reshape(T, 6), atol=1e-6)
    np.testing.assert_allclose(
        found.std, np.sqrt(np.diag(covariance)).reshape(T, 6), atol=1e-8
    )
    np.testing.assert_allclose(found.p, p, atol=1e-7 * np.abs(p).max())
    assert found.depth_map is MAP


def test_hyperparameters_are_found_with_the_trackers_errors(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    of = problem()
    last, given = latest(of), {}

    def estimate(scene: Scene, rows: object, **options: object) -> DepthMapEstimate:
        given.update(options)
        return replace(MAP, deviation=0.2)

    step = "ttus_opt.fitting.pose_error_step.estimate_depth_map"
    monkeypatch.setattr(step, estimate)
    found = of.step(last, estimate=True)
    assert found.depth_map.deviation == 0.2
    own = of.scene.trajectory
    poses = NOISE.moved(own.rotation, own.position, -last.xi)
    changes = of.rows.derivatives(*poses, NOISE)
    slope = np.stack([(c @ last.p).reshape(-1, 3) for c in changes], axis=2)
    seen = of.scene.f.reshape(-1, 3) - np.einsum("tij,tj->ti", slope, last.xi)
    np.testing.assert_allclose(given["force"], seen.ravel())
    t, u = 4, 7
    alike = np.exp(-abs(own.time[t] - own.time[u]) / 0.2)
    covariance = given["errors"](np.array([t, u]))  # type: ignore[operator]
    np.testing.assert_allclose(covariance[:3, 3:], alike * slope[t] @ slope[u].T)
    np.testing.assert_allclose(covariance[3:, 3:], slope[u] @ slope[u].T)


def test_the_start_is_the_field_for_exact_poses() -> None:
    of = problem(friction=0.0)
    start = of.start()
    assert not start.xi.any()
    own = of.scene.trajectory
    rows = of.rows.at(own.rotation, own.position)
    rest = (rows @ start.p - of.scene.f).reshape(-1, 3)[of.frames]
    assert np.sqrt(np.mean(rest**2)) < 0.1


def test_few_of_many_frames_are_used(monkeypatch: pytest.MonkeyPatch) -> None:
    every = problem().frames
    monkeypatch.setattr("ttus_opt.fitting.pose_error_step.MOST_FRAMES", 6)
    few = problem()
    assert len(few.frames) <= 6
    np.testing.assert_array_equal(few.frames, every[:: -(-len(every) // 6)])
    assert few.alike.shape == (16, len(few.frames))
    assert few.step(latest(few), estimate=False).xi.shape == (16, 6)

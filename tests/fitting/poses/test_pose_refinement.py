"""Poses refined by forces of a known field, whose true poses are known."""

import warnings
from dataclasses import replace
from functools import cache
from types import SimpleNamespace
from unittest.mock import patch

import numpy as np
import pytest
import scipy.sparse as sp
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import (
    InputError,
    MistakeWarning,
    NumericalError,
    TtusWarning,
    ellipsoid,
    refuses,
    torso,
)
from ttus_opt.contact.rows import PoseRows
from ttus_opt.fitting.poses import pose_refinement
from ttus_opt.fitting.poses.pose_error_step import Check, PoseErrorProblem
from ttus_opt.problem.terms.depth_profile import voxel_depths

NOISE = tt.TrackerNoise()
SHAPE = (14, 40, 16)


def sweep(seed, n=120):
    """A sweep that presses and releases, across the front."""
    rng = np.random.default_rng(seed)
    time = 0.1 * np.arange(n)
    angle = 1.57 + 0.5 * np.sin(0.6 * time + rng.uniform(0.0, 6.0))
    z = 0.1 + 0.02 * np.sin(0.9 * time + rng.uniform(0.0, 6.0))
    depth = 0.005 + 0.003 * np.sin(3.0 * time + rng.uniform(0.0, 6.0))
    r = torso().radius_at(angle, z) + 0.015 - depth
    position = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    outward = Rotation.from_euler("z", angle[:, None]).as_matrix()
    rotation = (
        outward @ Rotation.from_euler("y", 0.1 * np.sin(time)[:, None]).as_matrix()
    )
    return tt.Trajectory(time, position, rotation)


@cache
def examined(size=1.0, n=120):
    """A scene with errors of poses of ``size`` times the noise, and the true poses."""
    true = tt.Trajectory.concatenate([sweep(1, n), sweep(2, n)])
    rng = np.random.default_rng(5)
    alike = NOISE.correlations(true, np.arange(len(true)))
    drawn = np.linalg.cholesky(alike + 1e-9 * np.eye(len(true)))
    xi = size * drawn @ rng.standard_normal((len(true), 6))
    reported = replace(
        true,
        **dict(
            zip(
                ("rotation", "position"),
                NOISE.moved(true.rotation, true.position, xi),
                strict=True,
            )
        ),
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TtusWarning)
        scene = tt.Scene.assemble(
            tt.Voxmap.from_surface(torso(), shape=SHAPE, r_inner=0.03),
            ellipsoid(),
            reported,
        )
    theta, z = np.meshgrid(scene.voxmap.grid.theta, scene.voxmap.grid.z, indexing="ij")
    vary = 1.0 + 0.3 * np.sin(theta / 0.25) * np.cos(z / 0.025)
    depth = np.maximum(voxel_depths(scene.voxmap), 0.0) / 0.01
    p = 6.0 * depth**1.5 * np.broadcast_to(vary, SHAPE).ravel()
    at = scene.voxmap, scene.shell, pose_refinement.SAMPLING
    force = PoseRows(*at).at(true.rotation, true.position) @ p
    force = force.reshape(-1, 3) + rng.normal(0.0, 0.03, (len(true), 3))
    own = replace(reported, force=force, torque=np.zeros_like(force))
    return replace(scene, trajectory=own), true


@cache
def refined():
    """Estimated errors; two short sweeps are too few for the check by places."""
    with warnings.catch_warnings(), patch.object(Check, "better", True):
        warnings.simplefilter("error", TtusWarning)
        return tt.refine_poses(examined()[0], NOISE)


def depths(found, true, force):
    """By how much poses lie too deep, in frames with force [m]."""
    size = np.linalg.norm(force, axis=1)
    pressed = size > 0.5
    into = -force[pressed] / size[pressed, None]
    return np.asarray(((found.position - true.position)[pressed] * into).sum(axis=1))


@pytest.mark.slow
def test_errors_of_depth_are_found():
    scene, true = examined()
    force = scene.trajectory.force
    before = depths(scene.trajectory, true, force)
    after = depths(refined().trajectory, true, force)
    assert before.std() > 0.3e-3
    assert after.std() < 0.65 * before.std()
    assert abs(after.mean()) < 0.1e-3
    check = refined().check
    assert check is not None and check.places >= 3


def test_stated_errors_are_as_large_as_the_true_ones():
    scene, true = examined()
    rest = (refined().trajectory.position - true.position) / refined().std[:, :3]
    pressed = np.linalg.norm(scene.f.reshape(-1, 3), axis=1) > 0.5
    assert 0.7 < np.sqrt(np.mean(rest[pressed] ** 2)) < 1.3


def test_what_was_taken_off_is_told():
    scene, _ = examined()
    moved = scene.trajectory.position - refined().trajectory.position
    np.testing.assert_allclose(refined().errors[:, :3], moved, atol=1e-15)
    turned = scene.trajectory.rotation @ np.swapaxes(
        refined().trajectory.rotation, 1, 2
    )
    np.testing.assert_allclose(
        Rotation.from_matrix(turned).as_rotvec(), refined().errors[:, 3:], atol=1e-9
    )
    first, second = refined().recordings
    assert (len(first), len(second)) == (120, 120)
    np.testing.assert_array_equal(second.position, refined().trajectory.position[120:])


def test_exact_poses_stay_as_reported():
    scene, true = examined(0.0, 60)
    with pytest.warns(TtusWarning, match=r"show no errors of poses of 0.5 mm and 0.5°"):
        found = tt.refine_poses(scene, NOISE)
    assert found.gain < 0.0 < refined().gain
    assert found.trajectory is scene.trajectory
    assert not found.errors.any() and found.check is None and found.steps == 1
    np.testing.assert_array_equal(found.std, np.tile(NOISE.sizes, (len(true), 1)))
    np.testing.assert_array_equal(found.trajectory.position, true.position)


@pytest.mark.slow
def test_a_shifted_recording_is_no_noise(monkeypatch):
    scene, _ = examined()
    own = scene.trajectory
    outward = own.position * [1.0, 1.0, 0.0]
    outward /= np.linalg.norm(outward, axis=1)[:, None]
    second = (own.segment == 1)[:, None]
    shifted = replace(own, position=own.position - 2.5e-3 * second * outward)
    off = tt.Scene.assemble(scene.voxmap, scene.shell, shifted)
    monkeypatch.setattr(Check, "better", True)
    with pytest.warns(TtusWarning, match=r"recording \d seems reported [12]\..* mm"):
        tt.refine_poses(off, NOISE)


def standing(deep, segment):
    """A problem whose forces push along z, and errors of its depths [–]."""
    n = len(deep)
    time = np.arange(n, dtype=float)
    still = np.zeros((n, 3))
    turns = np.tile(np.eye(3), (n, 1, 1))
    trajectory = tt.Trajectory(time, still, turns, segment=np.array(segment))
    noise = tt.TrackerNoise(2e-3, 0.01, 0.0)
    frames = np.arange(n)
    xi = np.zeros((n, 6))
    xi[:, 2] = -np.array(deep)
    scene = SimpleNamespace(trajectory=trajectory)
    alike, unused = noise.correlations(trajectory, frames), None
    normal = sp.csr_array(np.kron(np.eye(n), [[0.0, 0.0, 1.0]]))
    at = unused, frames, frames, alike, unused, normal
    return PoseErrorProblem(scene, noise, *at), xi


def test_the_recording_that_differs_most_is_named():
    """Means 0, 6 and -1 against the others' -0.5, -0.5 and 3; variances 1/2 + 1/4."""
    problem, xi = standing([0.5, -0.5, 6.5, 5.5, -1.0, -1.0], [4, 4, 5, 5, 7, 7])
    words = r"recording 2 seems reported 13.00 mm deeper than the others, 8 standard"
    with pytest.warns(TtusWarning, match=words):
        pose_refinement._warn_of_offset(problem, xi)
    with pytest.warns(MistakeWarning, match="recording 2 .* shallower"):
        pose_refinement._warn_of_offset(problem, -xi)
    pose_refinement._warn_of_offset(problem, 0.5 * xi)  # 3.8 standard deviations


def test_one_recording_differs_from_none():
    pose_refinement._warn_of_offset(*standing([90.0, 110.0], [0, 0]))


def test_no_forces_refine_nothing():
    scene, true = examined()
    without = tt.Scene.assemble(scene.voxmap, scene.shell, true)
    refuses(
        InputError, "poses are refined by measured forces", tt.refine_poses, without
    )


@pytest.mark.slow
def test_steps_that_do_not_end_give_no_poses(monkeypatch):
    monkeypatch.setattr(pose_refinement, "MOST_STEPS", 2)
    monkeypatch.setattr(pose_refinement, "LEAST_GAIN", -np.inf)
    begun = []
    with pytest.raises(NumericalError, match=r"still move by .* after 2 steps"):
        tt.refine_poses(examined(1.0, 60)[0], progress=lambda: begun.append(1))
    assert len(begun) == 2


@pytest.mark.slow
def test_exact_poses_stay_where_the_evidence_is_not_asked(monkeypatch):
    """Places left out tell that the field of moved poses is a worse one."""
    monkeypatch.setattr(pose_refinement, "LEAST_GAIN", -np.inf)
    scene, _ = examined(0.0, 80)
    with pytest.warns(
        TtusWarning, match=r"places left out not clearly better .* left as rep"
    ):
        found = tt.refine_poses(scene, NOISE)
    assert found.trajectory is scene.trajectory
    check = found.check
    assert check is not None and check.places >= 3 and not check.better


def test_a_gain_within_its_standard_error_is_none():
    assert Check(3, 1.0, 1.2, 0.1).better
    assert not Check(3, 1.0, 1.2, 0.3).better
    assert not Check(2, 1.0, 1.2, 0.1).better


def test_too_few_places_to_check_move_no_pose(monkeypatch):
    monkeypatch.setattr(pose_refinement, "LEAST_GAIN", -np.inf)
    monkeypatch.setattr(PoseErrorProblem, "check", lambda *_: Check(2, 1.0, 2.0, 0.1))
    with pytest.warns(TtusWarning, match="2 places are too few to check"):
        assert not tt.refine_poses(examined(1.0, 60)[0], NOISE).errors.any()

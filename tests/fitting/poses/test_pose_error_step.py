"""Places left out in closed form, shared errors, and one shift of all frames."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.fitting.poses.test_pose_refinement import NOISE, examined, sweep
from ttus_opt.fitting.poses import pose_error_step
from ttus_opt.fitting.poses.pose_error_step import PoseErrorProblem
from ttus_opt.gaussian.matern import SeparableCovariance


def test_places_left_out_are_not_known():
    """Predictions equal those of the normal equations without the place's rows."""
    problem = PoseErrorProblem.of(examined(1.0, 60)[0], NOISE)
    state = problem.step(problem.start(), estimate=False)
    found = problem._left_out(state)
    covariance = state.given.factor @ state.given.factor.T
    normal = problem.normal[problem.frames]
    for number in np.unique(problem.place)[:2]:
        own = problem.place == number
        others = np.flatnonzero(~own)
        dual = np.zeros(len(covariance))
        dual[others] = np.linalg.solve(
            covariance[np.ix_(others, others)], state.given.data[others]
        )
        predicted = problem.reported @ state.prior.field(dual)
        error = (normal @ (problem.scene.f - predicted))[own]
        np.testing.assert_allclose(found[own], np.abs(error), rtol=1e-6)


def test_the_profile_as_a_whole_varies_too():
    """Against the covariance of all voxels, by the rows of the Matérn field."""
    problem = PoseErrorProblem.of(examined(1.0, 40)[0], NOISE)
    state = problem.start()
    prior, found = state.prior, state.depth_map
    voxmap, mean = problem.scene.voxmap, prior.mean
    lengths = found.surface_length, found.depth_length, found.length_ratio
    varied = SeparableCovariance.over(voxmap, found.deviation * mean, *lengths)
    D, dual = prior.rows.toarray(), np.cos(np.arange(len(problem.frames)))
    C = np.stack([varied.times(row) for row in D], axis=1)
    C += 0.5**2 * np.outer(mean, D @ mean)
    size = np.abs(D @ C).max()
    np.testing.assert_allclose(prior.of_rows / size, D @ C / size, atol=1e-9)
    size = np.abs(C @ dual).max()
    shift = (prior.field(dual) - mean) / size
    np.testing.assert_allclose(shift, C @ dual / size, atol=1e-9)


def test_frames_of_a_press_share_errors():
    problem = PoseErrorProblem.of(examined(1.0, 40)[0], NOISE)
    own = {"shared_error": 0.1, "sensor_noise": 0.2, "relative_noise": 0.01}
    depth_map = replace(problem.start().depth_map, **own)
    force = np.full(len(problem.frames), 5.0)
    noise = pose_error_step._noise(problem, depth_map, force)
    segment = problem.scene.trajectory.segment[problem.frames]
    at = int(np.flatnonzero(segment == 0)[0])
    other = int(np.flatnonzero(segment == 1)[0])
    assert noise[at, at] == pytest.approx(0.5**2 + 0.2**2 + 0.05**2)
    assert 0.5 * 0.5**2 < noise[at, at + 1] < 0.5**2
    assert noise[at, other] == 0.0


def test_one_shift_for_all_frames():
    """Of more than 800 frames in contact only some are used, but all are shifted."""
    own = tt.Trajectory.concatenate([sweep(1, 480), sweep(2, 480)])
    force = np.tile([0.0, 3.0, 0.0], (len(own), 1))
    pushed = replace(own, force=force, torque=np.zeros_like(force))
    small = examined(1.0, 40)[0]
    scene = tt.Scene.assemble(small.voxmap, small.shell, pushed)
    problem = PoseErrorProblem.of(scene, NOISE)
    touching = scene.rows.contact_points > 0
    assert touching.sum() > 800 > len(problem.frames)
    wave = np.sin(np.arange(len(own)) / 50.0)
    wave -= wave[problem.frames].mean()
    xi, normal = np.zeros((len(own), 6)), problem.normal.data.reshape(-1, 3)
    xi[:, :3] = -(0.3 + wave)[:, None] * normal
    found = problem.without_mean_depth(xi)
    np.testing.assert_allclose(
        problem.depth(found)[touching], wave[touching], atol=1e-12
    )
    assert problem.depth(xi)[touching].mean() == pytest.approx(0.3, abs=0.02)

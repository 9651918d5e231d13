"""Errors of reported depths that the depths themselves show.

A probe that is reported deep is so partly by the tracker's error ξ: given the reported
depth, the mean of ξ is not zero, and a law that is fitted to reported depths is too
soft (regression with errors in variables). With true depths of mean zero and covariance
K, errors of covariance R, both Gaussian,

    E[ξ | d] = R (K + R)⁻¹ d,

for independent frames of variance v the share δ²/(v + δ²) of d (regression
calibration). A hand moves smoothly, a tracker does not, so that the path of a recording
tells the one from the other:

    K = v exp(−½ (t − t')²/T²) + u² exp(−½ (t − t')²/(0.15 s)²),
    R = δ_d² exp(−|t − t'|/1 s) + δ_j² [t = t'].

A press of T and v, a hand's unrest u, drift δ_d and jitter δ_j are the most likely of a
recording's frames in contact. δ_d and δ_j are at most δ, which the forces tell (what
they follow is motion, however rough), and what half of the third differences of the
depths show: a robot's exact path has kinks, between which it is smooth.

Source: R. J. Carroll and others, Measurement Error in Nonlinear Models (2006), chapter
4. See docs/method/formulations.md, Depth map.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.contact.standing import deepest
from ttus_opt.core.arrays import Array
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.gaussian.conditioned import ByCovariance
from ttus_opt.gaussian.posterior_mode import posterior_mode
from ttus_opt.problem.terms.part_noise import lasting

#: Medians and logarithmic deviations of the priors: T [s], √v and u over the deviation
#: of the reported depths, δ_d and δ_j over δ [–]
MEDIANS = np.log([0.7, 1.0, 0.01, 1.0, 0.3])
DEVIATIONS = np.array([0.5, 0.5, 1.5, 1.0, 1.0])

#: Least T, and time of a hand's unrest [s]
SLOW, QUICK = 0.3, 0.15

#: Errors below this share of the depths' deviation change no force [–]
LEAST_SHARE = 0.02

#: Fewest frames whose roughness tells anything [–]
LEAST_FRAMES = 20

#: Variance that lets the covariance be factorised, over that of the depths [–]
ROUNDING = 1e-8

#: Most frames of a recording whose depths are used; of others between them only the
#: drift is told [–]
MOST_FRAMES = 400

#: Median size of a normal variable, over its standard deviation [–]
NORMAL_MEDIAN = 0.6745

#: Most evaluations of a path's density
CALLS = 200


@one_blas_thread()
def expected_errors(scene: Scene, error: float) -> Array:
    """Mean error of the reported depths, given all of them, shape (T,) [m].

    Positive where a probe is reported too deep; zero without contact.

    Args:
        scene: Patient, probe and poses.
        error: δ, standard deviation of the depths' errors [m].
    """
    poses, out = scene.trajectory, np.zeros(len(scene.trajectory))
    for part in poses.parts:
        frames = part.start + np.flatnonzero(scene.touching[part])
        if len(frames):
            own = poses.rotation[frames], poses.position[frames]
            depth, _ = deepest(scene.voxmap.surface, scene.shell, *own)
            out[frames] = errors_of_path(depth, poses.time[frames], error)
    return out


def errors_of_path(depth: Array, time: Array, error: float) -> Array:
    """The same of one recording's frames in contact.

    Args:
        depth: Reported depths, shape (n,) [m].
        time: Their times, shape (n,) [s].
        error: δ [m].

    Returns:
        Shape (n,) [m].
    """
    spread = float(depth.std())
    if len(depth) < LEAST_FRAMES:
        return np.zeros(len(depth))
    drift_most, jitter_most = np.minimum(_roughest(depth, time), error)
    if max(drift_most, jitter_most) <= LEAST_SHARE * spread:
        return np.zeros(len(depth))
    kept = np.arange(0, len(depth), -(-len(depth) // MOST_FRAMES))
    away = (depth[kept] - depth.mean()) / spread
    lag = time[kept, None] - time[kept]
    drifting, alike = lasting(time[:, None], time[kept]), np.eye(len(depth))[:, kept]
    unrest = np.exp(-0.5 * (lag / QUICK) ** 2)

    def errors(steps: Array) -> Array:
        drift, jitter = error * np.exp((MEDIANS + DEVIATIONS * steps)[3:])
        drift, jitter = min(drift, drift_most), min(jitter, jitter_most)
        return np.asarray((drift**2 * drifting + jitter**2 * alike) / spread**2)

    def given(steps: Array) -> ByCovariance:
        slow, v, u = np.exp((MEDIANS + DEVIATIONS * steps)[:3])
        motion = v**2 * np.exp(-0.5 * (lag / max(slow, SLOW)) ** 2) + u**2 * unrest
        total = motion + errors(steps)[kept] + ROUNDING * alike[kept]
        return ByCovariance.of(total, away)

    mode = posterior_mode(lambda steps: given(steps).log_density, 5, CALLS)
    return np.asarray(spread * (errors(mode.steps) @ given(mode.steps).multipliers))


def _roughest(depth: Array, time: Array) -> tuple[float, float]:
    """Largest δ_d and δ_j, if all of the median third difference came from one [m].

    Third differences of frames with the correlation r from one to the next have the
    variances (20 − 30 r + 12 r² − 2 r³) δ_d² and 20 δ_j².
    """
    r = float(lasting(np.asarray(np.median(np.diff(time))), np.zeros(())))
    rough = float(np.median(np.abs(np.diff(depth, 3)))) / NORMAL_MEDIAN
    drifting = 20.0 - 30.0 * r + 12.0 * r**2 - 2.0 * r**3
    return rough / np.sqrt(drifting), rough / np.sqrt(20.0)

"""Errors of tracked poses, estimated from the forces.

Half a millimetre of a tracker's drift changes a force as much as all other noise does.
Forces vary over the patient smoothly, errors of poses over time: a depth map
(`problem.terms.depth_map`) and a tracker's noise (`probe.tracker_noise`) tell them
apart. With ξ the errors, N(ξ) the force rows at the poses without them, p ~ N(φ, C) the
field and sensor noise Σ, the most probable errors given the forces,

    ξ̂ = argmin ½ rᵀ A r + ½ log det A⁻¹ + ½ ξᵀ K⁻¹ ξ,
    r = f − N(ξ) φ,   A⁻¹ = Σ + N(ξ) C N(ξ)ᵀ,

integrate over all fields. The determinant matters: without it, the field that is
fitted best counts as known, and all depths come out too large, with too soft a field
(errors in variables). Each step linearises N at the latest ξ; hyperparameters of the
depth map are found by evidence in the first steps, with the tracker's noise among the
errors.

A place that is visited once may be stiff or reported too shallow. Refined poses are
therefore kept only where the evidence gains, and where the field that belongs to them
predicts each place from all others better than the field of the poses as reported does.
See docs/method/identification.md, Errors of tracked poses.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), chapters 2 and 5; errors in variables: W. A. Fuller, Measurement Error Models
(1987).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.contact.rows import contact_rows
from ttus_opt.contact.scene import FORCES, Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError, MistakeWarning, NumericalError, warn
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.fitting.poses.pose_error_step import (
    LEAST_PLACES,
    Check,
    PoseErrorProblem,
    State,
)
from ttus_opt.fitting.weights.coarse_scene import coarser
from ttus_opt.probe.tracker_noise import TrackerNoise
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.terms.depth_map_estimate import DepthMapEstimate

#: Sampling of the depth map: without it, light and deep presses disagree on the depth
SAMPLING = "contact-size"

#: Steps in which hyperparameters are found, and most steps
ESTIMATES, MOST_STEPS = 2, 12

#: Mean change of ξ at which steps end [–]
CONVERGED = 0.02

#: Least gain of the log evidence by the tracker's noise: strong evidence for it
#: (R. E. Kass, A. E. Raftery, Bayes factors, J. Am. Stat. Assoc. 90, 1995) [–]
LEAST_GAIN = 3.0

#: A mean error of a recording so many times its standard deviation is not noise [–]
DOUBTFUL = 4.0


@dataclass(frozen=True, eq=False)
class RefinedPoses:
    """Recordings with the estimated errors of their poses taken off.

    Attributes:
        trajectory: All recordings, in their order, with refined poses.
        errors: Estimated errors of the reported poses, patient axes, (T, 6) [m, rad].
        std: Their posterior standard deviations, shape (T, 6) [m, rad].
        noise: The tracker's noise that was assumed.
        depth_map: Profile and hyperparameters of the field.
        steps: Number of steps.
        gain: Log evidence with the tracker's noise, less that without [–].
        check: Forces at places left out, at refined poses and as reported; None if
            poses are left as reported because of the gain alone.
    """

    trajectory: Trajectory
    errors: Array = field(repr=False)
    std: Array = field(repr=False)
    noise: TrackerNoise
    depth_map: DepthMapEstimate
    steps: int
    gain: float
    check: Check | None = None

    @property
    def recordings(self) -> list[Trajectory]:
        """The recordings one by one."""
        return self.trajectory.recordings


@one_blas_thread()
def refine_poses(
    scene: Scene,
    noise: TrackerNoise | None = None,
    *,
    progress: Callable[[], None] | None = None,
) -> RefinedPoses:
    """Estimate the errors of tracked poses from the forces, and take them off.

    Only forces are used. A coarser grid replaces one of more than 60,000 voxels.

    Args:
        scene: Patient, probe and recordings with forces.
        noise: The tracker's noise; 0.5 mm and 0.5° for a second by default.
        progress: Called before every step, at most `MOST_STEPS` times.

    Returns:
        Refined poses. A `TtusWarning` says if the forces show no errors of this size,
        or if places left out are not predicted better, so that poses are left as
        reported; or if a recording is off on average by more than the noise explains.

    Raises:
        InputError: No force was measured in contact, or the forces pull.
        NumericalError: The steps did not converge: there are no refined poses.
    """
    tracker = TrackerNoise() if noise is None else noise
    if not scene.trajectory.has_wrench:
        raise InputError(f"poses are refined by measured {FORCES}: the scene has none")
    small = _sampled(coarser(scene))
    problem = PoseErrorProblem.of(small, tracker)
    begin = progress or (lambda: None)
    begin()
    start = problem.start()
    first = problem.step(start, estimate=True)
    gain = first.depth_map.log_evidence - start.depth_map.log_evidence
    if gain < LEAST_GAIN:
        return _left(scene.trajectory, problem, start, gain)
    at, steps = _followed(problem, first, begin)
    check = problem.check(at, start)
    if not check.better:
        return _left(scene.trajectory, problem, start, gain, check)
    xi = problem.without_mean_depth(at.xi)
    _warn_of_offset(problem, xi)
    return RefinedPoses(
        tracker.without(scene.trajectory, xi),
        xi * tracker.sizes,
        at.std * tracker.sizes,
        tracker,
        at.depth_map,
        steps,
        gain,
        check,
    )


def _followed(
    problem: PoseErrorProblem, at: State, begin: Callable[[], None]
) -> tuple[State, int]:
    """The last state after the first step, and the number of steps.

    Raises:
        NumericalError: They did not converge.
    """
    for steps in range(2, MOST_STEPS + 1):
        begin()
        last, at = at, problem.step(at, estimate=steps <= ESTIMATES)
        change = float(np.abs(at.xi - last.xi).mean())
        if steps > ESTIMATES and change <= CONVERGED:
            return at, steps
    raise NumericalError(
        f"refined poses still move by {change:.2g} of the tracker's noise after "
        f"{MOST_STEPS} steps, so that there are none: the recordings hardly determine "
        "them; fit the poses as reported, or record more presses at the same places"
    )


def _left(
    trajectory: Trajectory,
    problem: PoseErrorProblem,
    start: State,
    gain: float,
    check: Check | None = None,
) -> RefinedPoses:
    """The recordings as they are, with a warning."""
    noise, none = problem.noise, np.zeros((len(trajectory), 6))
    if check is None:
        reason = (
            f"the forces show no errors of poses of {1e3 * noise.position:.3g} mm and "
            f"{np.degrees(noise.rotation):.3g}° (log evidence {gain:+.1f})"
        )
    elif check.places >= LEAST_PLACES:
        reason = (
            "refined poses predict places left out not clearly better than reported "
            f"({check.refined:.3f} N, {check.reported:.3f} N, their difference ± "
            f"{check.difference_error:.2g} N)"
        )
    else:
        reason = f"{check.places} places are too few to check refined poses by"
    warn(f"{reason}: the poses are left as reported; give the noise of your tracker", 3)
    exact = none + noise.sizes
    at = start.depth_map, 1, gain, check
    return RefinedPoses(trajectory, none, exact, noise, *at)


def _sampled(scene: Scene) -> Scene:
    """The scene with rows in `SAMPLING`."""
    poses = scene.trajectory.rotation, scene.trajectory.position
    rows = contact_rows(scene.voxmap, scene.shell, *poses, sampling=SAMPLING)
    return replace(scene, sampling=SAMPLING, rows=rows)


def _warn_of_offset(problem: PoseErrorProblem, xi: Array) -> None:
    """Warn of the recording whose mean depth differs most, where that is no noise.

    Compared with all others; the standard deviation of a mean is that of the
    Gauss–Markov process.
    """
    frames, alike = problem.frames, problem.alike[problem.frames]
    deep = problem.depth(xi)[frames]
    segment = problem.scene.trajectory.segment[frames]
    numbers = list(dict.fromkeys(segment.tolist()))
    if len(numbers) < 2:
        return
    found = []
    for number in numbers:
        own = segment == number
        apart = deep[own].mean() - deep[~own].mean()
        variance = sum(alike[np.ix_(each, each)].mean() for each in (own, ~own))
        found.append((apart / np.sqrt(variance), apart, number))
    most, apart, number = max(found, key=lambda each: abs(each[0]))
    if abs(most) > DOUBTFUL:
        sense = "deeper" if apart > 0.0 else "shallower"
        warn(
            f"recording {numbers.index(number) + 1} seems reported "
            f"{1e3 * problem.noise.position * abs(apart):.2f} mm {sense} than the "
            f"others, {abs(most):.0f} standard deviations of the tracker's noise: "
            "check its registration",
            3,
            MistakeWarning,
        )

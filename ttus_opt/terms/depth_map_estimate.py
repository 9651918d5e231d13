"""Estimate of a depth map's profile and hyperparameters by marginal likelihood.

With the field's covariance C and noise, the measured forces are Gaussian,

    f ~ N(N φ, K),   K = diag(σ_0² + ρ² ‖f_k‖²) + N C Nᵀ.

Their log density, the evidence, is maximised over the profile, its relative deviation
σ, the correlation length ℓ along the surface, the ratio of the lengths around and along
the patient, and the noise parameters σ_0 and ρ. The noise must grow with the force:
with constant noise, the larger errors of strong forces would be attributed to tissue
that varies from voxel to voxel, and ℓ would be too short. Weak log-normal priors keep
poorly determined values near those measured on soft tissue. The profile's coefficients
follow by non-negative least squares in the metric of K, with C from the profile at the
medians. Then profile and C are iterated, and the most likely iterate is used.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), section 5.4.1. See docs/method.md, Depth map.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.sparse as sp
from scipy.spatial.distance import cdist

from ttus_opt.arrays import Array, IntArray
from ttus_opt.errors import InputError
from ttus_opt.scene import Scene
from ttus_opt.terms.depth_profile import (
    EXPONENTS,
    DepthProfile,
    powers_of,
    voxel_depths,
)
from ttus_opt.terms.matern import matern
from ttus_opt.terms.posterior_mode import posterior_mode

#: Median and logarithmic standard deviation of the priors
PRIOR = {
    "surface_length": (0.03, 0.3),
    "deviation": (0.4, 1.0),
    "noise": (0.05, 1.0),
    "relative_noise": (0.03, 0.7),
    "length_ratio": (1.0, 1.0),
}

#: Initial ratios of lengths [–]: structures around the patient, such as ribs, and along
#: it are separate maxima of the posterior
RATIOS = (0.1, 10.0)

#: Most evaluations of the evidence
CALLS = 200

#: Most frames in the evidence, whose cost grows with their number cubed [–]
MOST_FRAMES = 150

#: Frames with a smaller force are ignored [N]
LEAST_FORCE = 0.1

#: Smallest noise over the forces, so that the covariance can be factorised [–]
LEAST_NOISE = 1e-4

#: Iterations of the profile and the covariance that depends on it
ROUNDS = 2


@dataclass(frozen=True)
class DepthMapEstimate:
    """The most likely profile and hyperparameters.

    Attributes:
        profile: φ.
        deviation: σ [–].
        surface_length: ℓ [m].
        depth_length: As given [m].
        noise: Root mean square of σ_n over the frames, of a force component [N].
        length_ratio: Length around the patient over length along it, of which ℓ is the
            geometric mean [–].
        log_evidence: Log evidence plus log prior, up to a constant [–].
        sensor_noise: σ_0 of a force component [N].
        relative_noise: ρ [–].
    """

    profile: DepthProfile
    deviation: float
    surface_length: float
    depth_length: float
    noise: float
    length_ratio: float
    log_evidence: float
    sensor_noise: float = 0.0
    relative_noise: float = 0.0


def estimate_depth_map(
    scene: Scene,
    rows: sp.csr_array | None = None,
    *,
    force: Array | None = None,
    errors: Callable[[IntArray], Array] | None = None,
    exponents: tuple[float, ...] = EXPONENTS,
    depth_length: float = 0.015,
) -> DepthMapEstimate:
    """Estimate profile, deviation, lengths and noise.

    Args:
        scene: A scene with measured forces.
        rows: Force rows, (3T, V); by default the scene's N (with drag: N − μ F).
        force: Forces, (3T,); by default the scene's [N].
        errors: Covariance of further errors of the forces in k given frames, as a
            function of the frames, (3k, 3k) [N²]; none by default.
        exponents: Exponents of the profile.
        depth_length: Matérn length along the depth, which forces hardly determine [m].

    Raises:
        InputError: No force was measured in contact, or the forces pull.
    """
    own = scene.N if rows is None else rows
    problem = _Problem.of(scene, own, exponents, depth_length, force, errors)
    medians = np.log([median for median, _ in PRIOR.values()])
    widths = np.array([width for _, width in PRIOR.values()])

    def chosen(steps: Array) -> _Chosen:
        return _Chosen(*np.exp(medians + widths * steps).tolist())

    first = problem.profile(chosen(np.zeros(len(PRIOR))), problem.least_squares())

    def log_evidence(steps: Array) -> float:
        return problem.evidence(chosen(steps), first)[0]

    starts = np.zeros((len(RATIOS), len(PRIOR)))
    starts[:, -1] = np.log(RATIOS) / widths[-1]
    mode = posterior_mode(log_evidence, len(PRIOR), CALLS, list(starts))
    found = chosen(mode.steps)
    coefficients = problem.profile(found, first)
    return DepthMapEstimate(
        DepthProfile(exponents, tuple(float(c) for c in coefficients)),
        found.deviation,
        found.surface_length,
        depth_length,
        float(np.sqrt(problem.variances(found).mean())),
        found.length_ratio,
        mode.log_posterior,
        found.noise,
        found.relative_noise,
    )


def least_squares_profile(
    scene: Scene, *, exponents: tuple[float, ...] = EXPONENTS
) -> DepthProfile:
    """The profile that alone explains the measured forces best, for equal noise.

    It takes milliseconds; what the evidence changes is in docs/method.md, Depth map.

    Args:
        scene: A scene with measured forces.
        exponents: Exponents of the profile.

    Raises:
        InputError: No force was measured in contact, or the forces pull.
    """
    chosen = (3 * _frames(scene, scene.f)[:, None] + np.arange(3)).ravel()
    depth = np.maximum(voxel_depths(scene.voxmap), 0.0)
    design = scene.N[chosen] @ powers_of(depth, exponents)
    coefficients = _coefficients(design, scene.f[chosen])
    return DepthProfile(exponents, tuple(float(c) for c in coefficients))


def _frames(scene: Scene, force: Array) -> IntArray:
    """Frames in contact with a force that counts.

    Raises:
        InputError: There is none.
    """
    size = np.linalg.norm(force.reshape(-1, 3), axis=1)
    touching = scene.rows.contact_points > 0
    frames = np.flatnonzero(touching & (size > LEAST_FORCE))
    if touching.any() and not len(frames):
        raise InputError(
            "a depth profile needs forces measured in contact, but where the probe "
            f"touches they reach {size[touching].max():.2g} N only: check the "
            "sensor and the trajectory's frame, or fit laplace_only"
        )
    if not len(frames):
        raise InputError(
            "a depth profile needs forces measured in contact, but the probe never "
            "touches the patient: check the trajectory's frame, or fit "
            "laplace_only"
        )
    return frames


def _coefficients(design: Array, force: Array) -> Array:
    """Nonnegative coefficients of a profile by least squares.

    Raises:
        InputError: No profile that grows with depth explains the forces.
    """
    c, _ = scipy.optimize.nnls(design, force)
    if not c.any():
        raise InputError(
            "the measured forces pull the probe in instead of pushing it out: give the "
            "force ON the probe in patient axes"
        )
    return np.asarray(c)


class _Chosen(NamedTuple):
    """Hyperparameters, in the order of `PRIOR`."""

    surface_length: float
    deviation: float
    noise: float
    relative_noise: float
    length_ratio: float


@dataclass(frozen=True)
class _Problem:
    """Measured forces and the voxels that they touch.

    Attributes:
        rows: Force rows over the touched voxels, shape (m, n).
        force: Measured forces, shape (m,) [N].
        powers: Powers of the touched voxels' depths, shape (n, exponents).
        spoke: Index of every voxel's spoke among the k touched ones, shape (n,).
        around: Distances of these spokes on the surface around the patient, (k, k) [m].
        along: The same along the patient, (k, k) [m].
        down: Correlation of the voxels along the depth, (n, n) [–].
        further: Covariance of further errors, shape (m, m) or () [N²].
    """

    rows: sp.csr_array = field(repr=False)
    force: Array = field(repr=False)
    powers: Array = field(repr=False)
    spoke: IntArray = field(repr=False)
    around: Array = field(repr=False)
    along: Array = field(repr=False)
    down: Array = field(repr=False)
    further: Array = field(repr=False)

    @classmethod
    def of(
        cls,
        scene: Scene,
        rows: sp.csr_array,
        exponents: tuple[float, ...],
        depth_length: float,
        force: Array | None = None,
        errors: Callable[[IntArray], Array] | None = None,
    ) -> _Problem:
        """Frames in contact, thinned evenly."""
        force = scene.f if force is None else force
        frames = _frames(scene, force)
        frames = frames[:: -(-len(frames) // MOST_FRAMES)]
        chosen = (3 * frames[:, None] + np.arange(3)).ravel()
        own = rows[chosen]
        touched = np.unique(own.indices)
        depth, grid = voxel_depths(scene.voxmap)[touched], scene.voxmap.grid
        n_spokes = grid.shape[1] * grid.shape[2]
        spokes, spoke = np.unique(touched % n_spokes, return_inverse=True)
        at = np.unravel_index(spokes, grid.shape[1:])
        theta, z = grid.theta[at[0]], grid.z[at[1]]
        radius = scene.voxmap.surface.radius_at(theta, z)
        place = np.stack([radius * np.cos(theta), radius * np.sin(theta)], axis=1)
        return cls(
            sp.csr_array(own[:, touched]),
            force[chosen],
            powers_of(np.maximum(depth, 0.0), exponents),
            spoke,
            cdist(place, place),
            np.abs(z[:, None] - z),
            matern(np.abs(depth[:, None] - depth), depth_length),
            np.zeros(()) if errors is None else errors(frames),
        )

    def variances(self, chosen: _Chosen) -> Array:
        """Noise variance of every row, shape (m,) [N²]."""
        squares = (self.force.reshape(-1, 3) ** 2).sum(axis=1)
        least = LEAST_NOISE**2 * squares.mean()
        own = chosen.noise**2 + chosen.relative_noise**2 * squares
        return np.repeat(np.maximum(own, least), 3)

    def least_squares(self) -> Array:
        """The profile's coefficients for equal noise and no variation.

        Raises:
            InputError: No profile that grows with depth explains the forces.
        """
        return _coefficients(self.rows @ self.powers, self.force)

    def profile(self, chosen: _Chosen, first: Array) -> Array:
        """Coefficients of the most likely profile, iterated with C.

        Args:
            chosen: Hyperparameters.
            first: Initial coefficients.
        """
        tried = [first]
        for _ in range(ROUNDS):
            tried.append(self.evidence(chosen, tried[-1])[1])
        return max(tried, key=lambda c: self.evidence(chosen, c, c)[0])

    def evidence(
        self, chosen: _Chosen, varied: Array, mean: Array | None = None
    ) -> tuple[float, Array]:
        """Log density of the forces, and the coefficients of the profile.

        Args:
            chosen: Hyperparameters.
            varied: Coefficients of the profile in C.
            mean: Coefficients of the mean; by default the most likely ones.
        """
        root = np.sqrt(chosen.length_ratio)
        between = np.hypot(self.around / root, self.along * root)
        on_surface = matern(between, chosen.surface_length)
        prior = on_surface[np.ix_(self.spoke, self.spoke)]
        prior *= chosen.deviation**2 * self.down
        scaled = self.rows @ sp.diags_array(self.powers @ varied)
        cov = scaled @ (scaled @ prior).T + self.further
        cov[np.diag_indices_from(cov)] += self.variances(chosen)
        factor = scipy.linalg.cholesky(cov, lower=True, overwrite_a=True)
        both = np.column_stack([self.rows @ self.powers, self.force])
        white = scipy.linalg.solve_triangular(factor, both, lower=True)
        c = mean
        if c is None:
            c, _ = scipy.optimize.nnls(white[:, :-1], white[:, -1])
            if not c.any():  # the variation alone explains the forces: keep a profile
                c = varied
        misfit = white[:, -1] - white[:, :-1] @ c
        normaliser = float(np.log(np.diag(factor)).sum())
        return -0.5 * float(misfit @ misfit) - normaliser, c

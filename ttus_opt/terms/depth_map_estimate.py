"""A depth map's profile and hyperparameters by their marginal likelihood.

With the field's covariance C and noise σ_n² I the measured forces are Gaussian,

    f ~ N(N φ, K),   K = σ_n² I + N C Nᵀ,

so that the logarithm of their density, the evidence, says how well a profile, a
relative deviation σ, a length ℓ along the surface and a noise σ_n explain them. Weak
log-normal priors keep what the data determine poorly near values measured on soft
tissue. The profile's coefficients follow by nonnegative least squares in the metric
of K.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), section 5.4.1. See docs/method.md, Depth map.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.sparse as sp
from scipy.spatial.distance import cdist

from ttus_opt.arrays import Array
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
PRIOR = {"surface_length": (0.03, 0.3), "deviation": (0.4, 0.5), "noise": (0.15, 1.0)}

#: Most frames that are looked at: evidence costs their number cubed [–]
MOST_FRAMES = 150

#: Frames with a smaller force are left out [N]
LEAST_FORCE = 0.1

#: Least noise as a share of the forces: with less the covariance could not be
#: factorised [–]
LEAST_NOISE = 1e-4

#: Rounds of the profile and the covariance that depends on it
ROUNDS = 2


@dataclass(frozen=True)
class DepthMapEstimate:
    """What the evidence chose.

    Attributes:
        profile: φ.
        deviation: σ [–].
        surface_length: ℓ [m].
        depth_length: As given [m].
        noise: σ_n, of a force component [N].
        log_evidence: With the priors, up to a constant [–].
    """

    profile: DepthProfile
    deviation: float
    surface_length: float
    depth_length: float
    noise: float
    log_evidence: float


def estimate_depth_map(
    scene: Scene,
    rows: sp.csr_array | None = None,
    *,
    exponents: tuple[float, ...] = EXPONENTS,
    depth_length: float = 0.015,
) -> DepthMapEstimate:
    """Choose profile, deviation, length and noise.

    Args:
        scene: With measured forces.
        rows: Force rows, (3T, V); the scene's N by default (with drag: N − μ F).
        exponents: Of the profile.
        depth_length: Matérn length along the depth, which forces hardly determine [m].

    Raises:
        InputError: No force is measured in contact, or all point outwards.
    """
    problem = _Problem.of(scene, scene.N if rows is None else rows, exponents)
    medians = np.log([median for median, _ in PRIOR.values()])
    widths = np.array([width for _, width in PRIOR.values()])

    least = LEAST_NOISE * float(np.sqrt(np.mean(problem.force**2)))

    def values(steps: Array) -> tuple[float, float, float]:
        length, deviation, noise = np.exp(medians + widths * steps)
        return float(length), float(deviation), max(float(noise), least)

    def log_evidence(steps: Array) -> float:
        return float(problem.evidence(*values(steps), depth_length)[0])

    mode = posterior_mode(log_evidence, 3, 150)
    length, deviation, noise = values(mode.steps)
    _, coefficients = problem.evidence(length, deviation, noise, depth_length)
    profile = DepthProfile(exponents, tuple(float(c) for c in coefficients))
    return DepthMapEstimate(
        profile,
        deviation,
        length,
        depth_length,
        noise,
        mode.log_posterior,
    )


@dataclass(frozen=True)
class _Problem:
    """Forces, and the voxels they were measured at.

    Attributes:
        rows: Over the touched voxels, shape (m, n).
        force: Shape (m,) [N].
        powers: Of the touched voxels' depths, shape (n, exponents).
        along: Distances of these voxels along the surface, (n, n) [m].
        down: Differences of their depths, (n, n) [m].
    """

    rows: sp.csr_array = field(repr=False)
    force: Array = field(repr=False)
    powers: Array = field(repr=False)
    along: Array = field(repr=False)
    down: Array = field(repr=False)

    @classmethod
    def of(
        cls, scene: Scene, rows: sp.csr_array, exponents: tuple[float, ...]
    ) -> _Problem:
        """Frames in contact, thinned evenly."""
        size = np.linalg.norm(scene.f.reshape(-1, 3), axis=1)
        frames = np.flatnonzero((scene.rows.contact_points > 0) & (size > LEAST_FORCE))
        if not len(frames):
            raise InputError(
                "depth_map needs forces measured in contact, the probe never touches "
                "the patient: check the trajectory's frame, or fit laplace_only"
            )
        frames = frames[:: -(-len(frames) // MOST_FRAMES)]
        chosen = (3 * frames[:, None] + np.arange(3)).ravel()
        own = rows[chosen]
        touched = np.unique(own.indices)
        depth, grid = voxel_depths(scene.voxmap)[touched], scene.voxmap.grid
        n_spokes = grid.shape[1] * grid.shape[2]
        spoke = np.unravel_index(touched % n_spokes, grid.shape[1:])
        theta, z = grid.theta[spoke[0]], grid.z[spoke[1]]
        radius = scene.voxmap.surface.radius_at(theta, z)
        place = np.stack([radius * np.cos(theta), radius * np.sin(theta), z], axis=1)
        return cls(
            sp.csr_array(own[:, touched]),
            scene.f[chosen],
            powers_of(np.maximum(depth, 0.0), exponents),
            cdist(place, place),
            np.abs(depth[:, None] - depth),
        )

    def evidence(
        self, length: float, deviation: float, noise: float, depth_length: float
    ) -> tuple[float, Array]:
        """Log density of the forces, and the profile's coefficients.

        Raises:
            InputError: No profile that grows with depth explains the forces.
        """
        prior = matern(self.along, length) * matern(self.down, depth_length)
        prior *= deviation**2
        shares = self.rows @ self.powers
        c, _ = scipy.optimize.nnls(shares, self.force)
        if not c.any():
            raise InputError(
                "depth_map: the measured forces pull the probe in instead of pushing "
                "it out: give the force ON the probe in patient axes"
            )
        for _ in range(ROUNDS):
            scaled = self.rows @ sp.diags_array(self.powers @ c)
            cov = scaled @ (scaled @ prior).T
            cov[np.diag_indices_from(cov)] += noise**2
            factor = scipy.linalg.cholesky(cov, lower=True, overwrite_a=True)
            both = np.column_stack([shares, self.force])
            white = scipy.linalg.solve_triangular(factor, both, lower=True)
            found, _ = scipy.optimize.nnls(white[:, :-1], white[:, -1])
            if found.any():  # else deviations alone explain more: keep a profile
                c = found
            misfit = white[:, -1] - white[:, :-1] @ c
        normaliser = float(np.log(np.diag(factor)).sum())
        return -0.5 * float(misfit @ misfit) - normaliser, c

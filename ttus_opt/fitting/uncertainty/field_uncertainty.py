"""Uncertainty of a fitted field and of the wrenches that it renders.

A quadratic fit has the prior p ~ N(p₀, C), measured rows D and their weights W², and
the estimate p₀ + G (t - D p₀), G = C Dᵀ(W⁻² + D C Dᵀ)⁻¹. Its error depends on the true
variances, p ~ N(p₀, v C) and noise of covariance Σ, which are found by marginal
likelihood (`wrench_noise`). Rows N of the field then have errors of covariance

    N ((1 - G D) v C (1 - G D)ᵀ + G Σ Gᵀ) Nᵀ.

C is L⁻¹Ω L⁻ᵀ for a Laplace prior (`laplace_posterior`), or known explicitly
(`covariance_posterior`). Where one solve per row is too expensive, the covariance is
that of random draws of the error, kept near the skin (`posterior`).

The error is that of the estimate without limits.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from ttus_opt.contact.places import places
from ttus_opt.contact.scene import BOUNDARY_SCALE, Scene
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.fitting.uncertainty.contact_spread import told_variance
from ttus_opt.fitting.uncertainty.covariance_posterior import (
    CovariancePosterior,
    wrenches,
)
from ttus_opt.fitting.uncertainty.laplace_posterior import LaplacePosterior
from ttus_opt.fitting.uncertainty.posterior import (
    Posterior,
    PosteriorDraws,
    checked_depth,
    skin_voxels,
)
from ttus_opt.fitting.uncertainty.wrench_noise import (
    LEAST_SHARE,
    ErrorModel,
    MeasuredWrenches,
    WrenchNoise,
    evenly,
)
from ttus_opt.fitting.uncertainty.wrench_uncertainty import WrenchUncertainty
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.solution import Solution
from ttus_opt.problem.terms.structure import UncertainMean
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.voxmap.field import PotentialField

Method = Literal["exact", "samples"]

#: Largest grid on which every rendered row is solved for [voxels]
MOST_VOXELS = 60_000

#: Draws on larger grids, for standard deviations to 4 % [–]
DRAWS = 256

#: Depth below the skin down to which draws are kept [m]
DEPTH = 0.03

#: Least median of the prior variance, for exact data [–]
LEAST_VARIANCE = 1e-12

#: Images solved for at once, which the cache holds [–]
AT_ONCE = 16

#: Components of a wrench by measured term
COMPONENTS = {"force": slice(0, 3), "torque": slice(3, 6)}


@dataclass(frozen=True, eq=False)
class Uncertainty:
    """The errors of one fit.

    Attributes:
        scene: Patient, probe and measurements.
        potential: The fitted field.
        method: "exact" solves for rows, "samples" renders draws of the error.
        variance: v, the prior variance over that assumed by the fit [–].
        noise: Noise of measured wrenches.
    """

    scene: Scene = field(repr=False)
    potential: PotentialField = field(repr=False)
    method: Method
    variance: float
    noise: WrenchNoise
    _posterior: Posterior = field(repr=False)
    _draws: PosteriorDraws | None = field(repr=False)

    def std(self, trajectory: Trajectory) -> WrenchUncertainty:
        """Uncertainty of the wrenches rendered along a trajectory.

        Args:
            trajectory: Poses; with drag, their motion matters.

        Returns:
            NaN in frames that reach deeper than draws are kept.
        """
        at = self.potential, self.scene.shell, trajectory
        return WrenchUncertainty.of(*at, self.covariance, self.noise)

    @one_blas_thread()
    def covariance(
        self, rows: sp.csr_array, height: int = 1, sized: Array | None = None
    ) -> Array:
        """Covariance of the errors of blocks of consecutive rows of the field.

        Args:
            rows: N, shape (k · height, V).
            height: Rows of a block [–].
            sized: Change of N p per ln ℓ₀ of `contact-size`, whose error is part of
                that of a depth map, shape (k · height,); None for 0.

        Returns:
            Shape (k, height, height); NaN where a block touches voxels at which draws
            are not kept.

        Raises:
            InputError: Another number of voxels, or an incomplete block.
        """
        if rows.shape[1] != self.scene.n_voxels or rows.shape[0] % height:
            raise InputError(
                f"rows must be (k · {height}, {self.scene.n_voxels}), got {rows.shape}"
            )
        if self._draws is not None:
            return self._draws.covariance(rows, height, sized)
        return self._posterior.covariance(rows, height, sized)

    @one_blas_thread()
    def potential_std(self) -> Array:
        """Standard deviation of the field, shape (n_r, n_θ, n_z) [unit of the field].

        Always from draws.
        """
        draws, _ = self._posterior.draw(DRAWS)
        variance = np.zeros(draws.shape[1])
        for draw in draws:  # one at a time in double precision
            variance += draw.astype(np.float64) ** 2 / len(draws)
        return np.asarray(self.scene.voxmap.grid.unflatten(np.sqrt(variance)))

    @one_blas_thread()
    def draws(self, count: int = DRAWS, depth: float = DEPTH) -> PosteriorDraws:
        """Random draws of the error near the skin.

        Args:
            count: Number of draws, at least 2; standard deviations are accurate to
                1/√(2 count) [–].
            depth: Depth below the skin down to which they are kept [m].

        Raises:
            InputError: A smaller count, or a depth that is not between 0 and 1 m.
        """
        kept = self._draws
        if kept is not None and kept.depth == depth and 1 < count <= len(kept.values):
            few = kept.values[:count], kept.sizes[:count]
            return PosteriorDraws(*few, kept.voxels, depth)
        if not (isinstance(count, int | np.integer) and count > 1):
            raise InputError(
                f"the number of draws must be a whole number above 1, got {count}"
            )
        voxels = skin_voxels(self.scene.voxmap, depth)
        return PosteriorDraws(*self._posterior.draw(count, voxels), voxels, depth)

    def sampled(self, count: int = DRAWS, depth: float = DEPTH) -> Uncertainty:
        """The same by the method "samples"; arguments as for `draws`."""
        return replace(self, method="samples", _draws=self.draws(count, depth))


def uncertainty(
    solution: Solution,
    scene: Scene,
    *,
    method: Method | None = None,
    depth: float = DEPTH,
) -> Uncertainty:
    """Uncertainty of the field of a solution.

    Args:
        solution: The solution for one field with a prior (a Laplace term or one of
            known covariance) and squares of measured rows.
        scene: The scene it was fitted to.
        method: "exact" solves for every rendered row, "samples" draws `DRAWS` fields
            once; None takes "samples" for a Laplace prior on more than 60,000 voxels.
        depth: Depth below the skin down to which draws and, on more than 60,000 voxels,
            the basis are kept [m].

    Raises:
        InputError: Another kind of problem, another scene, no measurements, an unknown
            method or an unusable depth.
    """
    if not isinstance(solution, Solution):
        raise InputError(
            "uncertainty needs a Solution of ttus_opt.fit, got a "
            f"{type(solution).__name__}: comparators have no uncertainty"
        )
    if method is not None and method not in get_args(Method):
        raise InputError(f"method must be exact or samples, got {method!r}")
    checked_depth(depth)
    program = solution.program
    prior = _prior_of(solution)
    if program.laplace is not scene.laplace:
        raise InputError(
            "the solution belongs to another scene, or to one that it was pickled "
            "without: pass its own scene, and pickle both as one, (scene, solution)"
        )
    used = (t for t in program.terms if t.weight > 0.0 and len(t.target))
    measured = [t for t in used if t is not prior]
    frames = len(scene.trajectory)
    if not measured or any(len(t.target) != 3 * frames for t in measured):
        raise InputError(
            "uncertainty needs measured terms with three rows per frame: fit eq10 or "
            "another formulation with measured forces"
        )
    known = prior.known_covariance
    if method is None:
        method = "exact" if known or scene.n_voxels <= MOST_VOXELS else "samples"
    near = method == "samples" or (known is None and scene.n_voxels > MOST_VOXELS)
    voxels = skin_voxels(scene.voxmap, depth) if near else None
    potential = solution.field
    posterior: LaplacePosterior | CovariancePosterior
    with one_blas_thread():  # others wait for each other on a busy machine
        if known:
            values = potential.values.reshape(-1)
            posterior = CovariancePosterior.of(prior, measured, values)
        else:
            scale = BOUNDARY_SCALE in solution.parameters and BOUNDARY_SCALE not in (
                solution.not_identified
            )
            posterior = LaplacePosterior.of(DualData.of(program), scale, voxels)
        mean = None if known is None else known.mean
        estimated = _errors(scene, potential, prior, measured, posterior, mean)
        variance, noise, errors = estimated
        posterior = posterior.with_errors(errors)
        draws = None
        if voxels is not None and method == "samples":
            draws = PosteriorDraws(*posterior.draw(DRAWS, voxels), voxels, depth)
    return Uncertainty(scene, potential, method, variance, noise, posterior, draws)


def _prior_of(solution: Solution) -> ProgramTerm:
    """The prior of the field.

    Raises:
        InputError: There is none, or there are unknowns beside the field.
    """
    program = solution.program
    prior = program.known_prior or program.laplace_prior
    one_field = program.n_variables == len(program.laplace.free)
    if prior is None or not (one_field and program.is_quadratic):
        raise InputError(
            f"no uncertainty for {solution.formulation}: it needs one field, a prior "
            "(a Laplace term or one of known covariance) and squares of measured rows"
        )
    return prior


def _errors(
    scene: Scene,
    potential: PotentialField,
    prior: ProgramTerm,
    measured: list[ProgramTerm],
    posterior: Posterior,
    mean: UncertainMean | None,
) -> tuple[float, WrenchNoise, ErrorModel]:
    """The prior's variance, the noise, and both for the weighted rows.

    Raises:
        InputError: A measured term other than force and torque.
    """
    others = [t.name for t in measured if t.name not in COMPONENTS]
    if others:
        raise InputError(
            f"no uncertainty with the term {others[0]}: only the noise of forces and "
            "torques is known"
        )
    values, frames = potential.values.reshape(-1), len(scene.trajectory)
    wrench, weighted = np.zeros((frames, 6)), []
    for term in measured:
        wrench[:, COMPONENTS[term.name]] = wrenches(term, values).reshape(frames, 3)
        by = term.whitening
        by = sp.eye_array(3 * frames, format="csr") if by is None else by
        weighted.append(np.sqrt(term.weight / prior.weight) * by)
    informative = posterior.informative
    touching = scene.touching
    mixed = sp.csc_array(sp.block_diag(weighted))
    at = np.arange(mixed.shape[0]).reshape(len(measured), frames, 3)[:, touching]
    at = at.transpose(1, 0, 2).reshape(len(wrench[touching]), -1)
    given, inverse = posterior.measured, splu(mixed)

    def unmixed(rows: Array, at: IntArray) -> Array:
        """Weighted rows, (k, rows), as wrenches of some frames, (k, n, h)."""
        out = np.empty((len(rows), *at.shape))
        for few in (slice(i, i + AT_ONCE) for i in range(0, len(rows), AT_ONCE)):
            whole = np.zeros((mixed.shape[0], len(rows[few])))
            whole[informative] = rows[few].T
            out[few] = inverse.solve(whole).T[:, at]
        return out

    usual = np.nan
    if mean is not None:  # root mean square of the forces
        usual = float(np.sqrt(np.mean(np.sum(wrench[touching, :3] ** 2, axis=1))))
    seen = MeasuredWrenches(
        np.zeros((0, *at.shape)),
        unmixed(given.data[None], at)[0],
        wrench[touching],
        places(scene.presses[touching], scene.trajectory.position[touching]),
        np.concatenate([np.arange(6)[COMPONENTS[t.name]] for t in measured]),
        usual,
    )
    images = unmixed(posterior.images, at[evenly(len(at))])
    few = replace(seen.thinned(), images=images)
    likeliest = given.square / len(given.data)
    likeliest = max(likeliest, LEAST_VARIANCE)
    if mean is None:
        variance, noise = few.estimate(likeliest)
    else:
        known = told_variance(scene, mean)
        variance, noise = few.estimate(likeliest, known, mean.shared_error)
        share = max(noise.place_share, LEAST_SHARE)
        noise = replace(noise, place_share=share)
    weights = sp.csr_array(sp.csr_array(mixed)[informative])
    # whole places turned and shifted like residuals, as the noise of a depth map,
    # would predict new places half as well as the errors by parts that it takes
    by_parts = mean is not None and all(t.whitening is not None for t in measured)
    of_row = float(np.sqrt(max(likeliest, 1.0))) if by_parts else None
    errors = seen.errors(variance, noise, weights, at, of_row)
    return variance, noise, errors

"""How sure a fitted field is of the wrenches that it renders, and of itself.

A quadratic fit is the mean of a Gaussian: prior p ~ N(p₀, σ² C), measured rows D of
weights W² with noise of variance σ² W⁻². So any rows N of a field have the posterior
covariance

    Cov[N p] = σ² (N C Nᵀ - N C Dᵀ(W⁻² + D C Dᵀ)⁻¹ D C Nᵀ)

(Rasmussen and Williams, 2006, eq. 2.24). C is L⁻¹Ω L⁻ᵀ where a Laplace term is the
prior (`laplace_posterior`), or known by itself (`covariance_posterior`). Where solves
per row cost too much, the covariance is that of fields drawn from the posterior, kept
near the skin (`posterior_draws`).

Limits are left out: the doubt is that of the Gaussian without them. σ² is such that
95 % of the measured components lie within 1.96 standard deviations of what the field of
all other presses predicts; with one press, the likeliest.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.errors import InputError
from ttus_opt.fitting.covariance_posterior import CovariancePosterior
from ttus_opt.fitting.laplace_posterior import LaplacePosterior
from ttus_opt.fitting.posterior import Posterior
from ttus_opt.fitting.posterior_draws import PosteriorDraws, skin_voxels
from ttus_opt.fitting.weight_criteria import presses
from ttus_opt.fitting.wrench_doubt import WrenchDoubt, wrench_rows
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.problem.solution import Solution
from ttus_opt.scene import BOUNDARY_SCALE, Scene
from ttus_opt.solvers.dual.data import DualData, laplace_prior, root_weights
from ttus_opt.terms.structure import known_covariance

Method = Literal["exact", "samples"]

#: Largest grid whose rows are solved for one by one [voxels]
MOST_VOXELS = 60_000

#: Draws of the posterior where they are not: standard deviations to 4 % [–]
DRAWS = 256

#: How far below the skin draws are kept [m]
DEPTH = 0.03


@dataclass(frozen=True)
class Doubt:
    """The posterior of one fit.

    Attributes:
        scene: Patient, probe and measurements.
        variance: σ², of a row of weight 1 [N²].
        method: Whether rows are solved for, or drawn fields are rendered.
        calibrated_by: ``presses left out``, or ``likelihood`` where there is one press.
        noise: Standard deviations of what a measured force and torque component show
            beside the field; NaN where there is none [N, N·m].
        parameters: Of the fit, by name.
    """

    scene: Scene = field(repr=False)
    variance: float
    method: Method
    calibrated_by: str
    noise: tuple[float, float]
    parameters: Mapping[str, float] = field(repr=False)
    _posterior: Posterior = field(repr=False)
    _draws: PosteriorDraws | None = field(repr=False)

    def std(self, trajectory: Trajectory) -> WrenchDoubt:
        """How sure the field is of what it renders along a trajectory.

        Args:
            trajectory: Poses; with drag their motion counts.

        Returns:
            NaN in frames that reach deeper than draws are kept.
        """
        scene = self.scene
        there = scene.voxmap, scene.shell, scene.sampling
        rows = wrench_rows(*there, trajectory, self.parameters)
        return WrenchDoubt(self.covariance(rows, 6), *self.noise)

    def covariance(self, rows: sp.csr_array, height: int = 1) -> Array:
        """Posterior covariance of consecutive rows of a field.

        Args:
            rows: N, shape (k · height, V).
            height: Rows of a block [–].

        Returns:
            The blocks, shape (k, height, height); NaN where rows touch voxels at which
            draws are not kept.

        Raises:
            InputError: Another number of voxels, or rows that are no whole blocks.
        """
        if rows.shape[1] != self.scene.n_voxels or rows.shape[0] % height:
            raise InputError(
                f"rows must be (k · {height}, {self.scene.n_voxels}), got {rows.shape}"
            )
        if self._draws is not None:
            return self._draws.covariance(rows, height)
        return self.variance * self._posterior.covariance(rows, height)

    def potential_std(self) -> Array:
        """Standard deviation of the field, shape (n_r, n_θ, n_z) [of the field].

        By draws, whatever the method.
        """
        draws = self._posterior.draw(DRAWS)
        std = np.sqrt(self.variance * np.mean(draws.astype(np.float64) ** 2, axis=0))
        return np.asarray(self.scene.voxmap.grid.unflatten(std))

    def draws(self, count: int = DRAWS, depth: float = DEPTH) -> PosteriorDraws:
        """Fields drawn from the posterior around its mean, near the skin.

        Args:
            count: How many; standard deviations are known to 1/√(2 count) [–].
            depth: How far below the skin [m].

        Raises:
            InputError: Numbers that are not positive.
        """
        kept = self._draws
        if kept is not None and kept.depth == depth and 1 < count <= len(kept.values):
            return PosteriorDraws(kept.values[:count], kept.voxels, depth)
        if not (count > 1 and depth > 0.0):
            raise InputError(
                f"draws need a count above 1 and a positive depth, got {count} and "
                f"{depth} m"
            )
        voxels = skin_voxels(self.scene.voxmap, depth)
        return _drawn(self._posterior, self.variance, count, depth, voxels)

    def sampled(self, count: int = DRAWS, depth: float = DEPTH) -> Doubt:
        """The same by draws, that are made once.

        Args:
            count: As of `draws` [–].
            depth: As of `draws` [m].
        """
        return replace(self, method="samples", _draws=self.draws(count, depth))


def doubt(
    solution: Solution,
    scene: Scene,
    *,
    method: Method | None = None,
    depth: float = DEPTH,
) -> Doubt:
    """The posterior behind a solution.

    Args:
        solution: Of one field: a prior, Laplace's or of known covariance, and squares
            of measured rows.
        scene: Which it was fitted to.
        method: "exact" solves for every rendered row, "samples" draws `DRAWS` fields
            once; None takes the latter on more than 60,000 voxels where a Laplace term
            is the prior.
        depth: How far below the skin draws, and on more than 60,000 voxels the basis,
            are kept [m].

    Raises:
        InputError: The problem has another prior or other unknowns, the scene is
            another, or nothing was measured.
    """
    program = solution.program
    prior = _prior_of(solution)
    if program.laplace is not scene.laplace:
        raise InputError("the solution is of another scene: give the one it is of")
    measured = [t for t in program.terms if t.weight > 0.0 and t is not prior]
    frames = len(scene.trajectory)
    if not measured or any(len(t.target) != 3 * frames for t in measured):
        raise InputError(
            "doubt needs measured terms with three rows per frame: fit eq10 or another "
            "formulation with measured forces"
        )
    known = known_covariance(prior.tags) is not None
    if method is None:
        method = "exact" if known or scene.n_voxels <= MOST_VOXELS else "samples"
    near = method == "samples" or (not known and scene.n_voxels > MOST_VOXELS)
    voxels = skin_voxels(scene.voxmap, depth) if near else None
    posterior: LaplacePosterior | CovariancePosterior
    if known:
        posterior = CovariancePosterior.of(program, prior, measured)
    else:
        scale = BOUNDARY_SCALE in solution.parameters and BOUNDARY_SCALE not in (
            solution.not_identified
        )
        posterior = LaplacePosterior.of(
            DualData.of(program), root_weights(program), scale, voxels
        )
    frame = np.concatenate([np.repeat(np.arange(frames), 3)] * len(measured))
    told: Mask = posterior.told
    variance, how = posterior.measured.scale_of(presses(scene)[frame[told]])
    draws = None
    if voxels is not None and method == "samples":
        draws = _drawn(posterior, variance, DRAWS, depth, voxels)
    noise = _noise(scene, measured, variance * prior.weight)
    parameters = dict(solution.parameters)
    return Doubt(scene, variance, method, how, noise, parameters, posterior, draws)


def _prior_of(solution: Solution) -> ProgramTerm:
    """The term that is the prior of the field.

    Raises:
        InputError: There is none, or there are other unknowns.
    """
    program = solution.program
    prior = _known_prior(program) or laplace_prior(program)
    one_field = program.n_variables == len(program.laplace.free)
    if prior is None or not (one_field and program.is_quadratic):
        raise InputError(
            f"no doubt of {solution.formulation}: it needs one field, a prior (a "
            "Laplace term or one of known covariance) and squares of measured rows"
        )
    return prior


def _known_prior(program: Program) -> ProgramTerm | None:
    known = (t for t in program.terms if known_covariance(t.tags) is not None)
    return next((t for t in known if t.weight > 0.0), None)


def _noise(
    scene: Scene, measured: list[ProgramTerm], variance: float
) -> tuple[float, float]:
    """What measured force and torque components show beside the field [N, N·m]."""
    noise = {t.name: float(np.sqrt(variance / t.weight)) for t in measured}
    if "torque" in noise:  # rows of torque are over a length
        own = next(t.target for t in measured if t.name == "torque")
        noise["torque"] *= float(np.linalg.norm(scene.tau) / np.linalg.norm(own))
    return noise.get("force", np.nan), noise.get("torque", np.nan)


def _drawn(
    posterior: Posterior, variance: float, count: int, depth: float, voxels: IntArray
) -> PosteriorDraws:
    values = posterior.draw(count, voxels)
    values *= np.float32(np.sqrt(variance))
    return PosteriorDraws(values, voxels, depth)

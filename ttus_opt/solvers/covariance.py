"""Gaussian-process regression: a prior of known covariance, few measured rows.

Where a term's square rows R have a covariance C = (RᵀR)⁻¹ that is known at single
voxels (`ttus_opt.problem.terms.structure.KnownCovariance`), the minimiser of
‖R p − t₀‖² + ‖D p + E c − t‖² is

    p = p̄ + C Dᵀ y,   p̄ = C Rᵀ t₀,   S = I + D C Dᵀ,   S y = t − D p̄ − E c,

where C is only used among the voxels that D touches, by its parts. S is factorised
once, or the equivalent matrix over independent columns of C where they are fewer than
the rows; what that leaves out, conjugate gradients make up for. The unknowns c beside
the field solve a least-squares problem within their bounds.

Source: C. E. Rasmussen, C. K. I. Williams, Gaussian Processes for Machine Learning
(2006), sections 2.2 and 2.7. See docs/method/formulations.md, Depth map.
"""

from __future__ import annotations

import math

import numpy as np
import scipy.linalg
import scipy.optimize
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.gaussian.conditioned import conditioned
from ttus_opt.gaussian.matern import VoxelColumns
from ttus_opt.gaussian.prior import partial_root
from ttus_opt.problem.members import ProgramTerm, StackedTerms, nonempty_columns
from ttus_opt.problem.program import Program
from ttus_opt.problem.terms.structure import KnownCovariance
from ttus_opt.solvers.base import Candidate, Capabilities, Prepared, Solver
from ttus_opt.solvers.conjugate_gradients import norm, to_residual
from ttus_opt.solvers.dual.data import duals_without_limits, terms_beside

#: Most voxels that measured rows may touch: for 33,477 of 5.4 million, 8 GiB
LARGEST = 40_000

#: Eigenvalues below this part of the largest are rounding [–]
ROUNDING = 1e-14

#: Parts of the largest prior variance below which the factor of S leaves out the rest:
#: conjugate gradients make up for it, or a second factor where measurements are so
#: accurate that they do not
NEGLECTED = (1e-3, 1e-6)

#: Relative residual of the dual, and most steps of conjugate gradients
ACCURACY, MOST_STEPS = 1e-14, 60


class _Loaded(Prepared):
    _columns: VoxelColumns
    _tag: KnownCovariance | None = None

    @one_blas_thread()
    def update(self, program: Program) -> None:
        """Take other data; the covariance is kept while voxels and prior stay."""
        prior = program.known_prior
        assert prior is not None
        V = len(prior.target)
        measured = terms_beside(program, prior)
        stacked = StackedTerms.of(measured, program.n_variables, prior.weight)
        self._target, rows = stacked.root * stacked.target, stacked.weighted
        self._beside = rows[:, V:].toarray()
        self._bounds = tuple(bound[V:] for bound in program.box)
        self._take_prior(prior, _touched(program, prior))
        self._rows = sp.csr_array(rows[:, :V])
        self._touching = sp.csr_array(self._rows.tocsc()[:, self._columns.voxels])
        self._program = program
        self._factorise()

    def _take_prior(self, prior: ProgramTerm, voxels: IntArray) -> None:
        """The covariance of the touched voxels and the prior's mean."""
        tag = prior.known_covariance
        assert tag is not None
        if tag is self._tag and np.array_equal(voxels, self._columns.voxels):
            return
        self._tag = tag
        self._columns = tag.covariance.columns(voxels)
        self._take_root(NEGLECTED[0])
        own = (prior.matrix.T @ prior.target)[: len(prior.target)]
        self._mean = tag.covariance.times(own)

    def _take_root(self, neglected: float) -> None:
        self._neglected = neglected
        own = self._columns
        self._root = partial_root(own.variance, own.among_some, neglected)

    def _factorise(self) -> None:
        """Nearly S, by its factor or that of the root's columns."""
        images = np.ascontiguousarray((self._touching @ self._root).T)
        self._nearly = conditioned(images, self._target)

    def _inverse(self, right_side: Array) -> Array:
        """S⁻¹ of every column, shape (m,) or (m, k), by preconditioned CG."""
        if right_side.ndim == 2:
            return np.stack([self._inverse(column) for column in right_side.T], axis=1)
        D, C = self._touching, self._columns
        run = to_residual(
            lambda y: y + D @ C.among_times(D.T @ y),
            right_side,
            self._nearly.solve,
            ACCURACY,
            MOST_STEPS,
            None,
        )
        enough = norm(run.rest) <= ACCURACY * norm(right_side)
        if enough or self._neglected == NEGLECTED[-1]:
            return run.y
        self._take_root(NEGLECTED[-1])
        self._factorise()
        return self._inverse(right_side)

    @one_blas_thread()
    def solve(self) -> Candidate:
        """The unknowns beside the field, the multipliers, the field."""
        misfit = self._target - self._rows @ self._mean
        c = self._parameters(misfit)
        misfit = misfit - self._beside @ c
        y = self._inverse(misfit)
        p = self._mean + self._columns.times(self._touching.T @ y)
        x = np.concatenate([p, c])
        return Candidate(x, duals_without_limits(self._program, x))

    def _parameters(self, misfit: Array) -> Array:
        """Minimise (misfit − E c)ᵀ S⁻¹ (misfit − E c) within bounds."""
        E = self._beside
        if not E.shape[1]:
            return np.zeros(0)
        lower, upper = self._bounds
        moving = E.any(axis=0)
        c = np.clip(np.zeros(E.shape[1]), lower, upper)
        if not moving.any():
            return np.asarray(c)
        gram = E[:, moving].T @ self._inverse(E[:, moving])
        slope = self._inverse(misfit - E @ np.where(moving, 0.0, c)) @ E[:, moving]
        values, turn = scipy.linalg.eigh((gram + gram.T) / 2.0)
        kept = values > ROUNDING * values.max()
        root = (turn[:, kept] * np.sqrt(values[kept])).T
        aim = turn[:, kept].T @ slope / np.sqrt(values[kept])
        found = scipy.optimize.lsq_linear(
            root, aim, (lower[moving], upper[moving]), method="bvls", tol=1e-14
        )
        c[moving] = found.x
        return np.asarray(c)


class Covariance(Solver):
    """Dense Cholesky factors of the dual, from the prior's covariance."""

    name = "covariance"
    loaded = _Loaded
    summary = "Gaussian-process regression: a prior whose covariance is known"
    capabilities = Capabilities(
        inequalities=True,
        equalities=False,
        any_terms=False,
        time_limit=False,
        keeps="the covariance of the touched voxels while the rows stay",
    )

    def refusal(self, program: Program) -> str:
        """Takes a prior of known covariance, squares of few rows, bounds beside p."""
        return self._structural(program) or self.excess(program)

    def _structural(self, program: Program) -> str:
        """Why it cannot take a program of any size."""
        if base := super().refusal(program):
            return base
        prior = program.known_prior
        if prior is None:
            return "it needs a term whose covariance is known, such as depth_map"
        V = len(prior.target)
        if any(np.isfinite(bound[:V]).any() for bound in program.box):
            return "it takes no bounds of the field"
        if program.constraints:
            return "it takes no constraints but bounds of parameters"
        return ""

    def excess(self, program: Program) -> str:
        """As of `Solver`: too many voxels that measured rows touch."""
        prior = program.known_prior
        if prior is None or self._structural(program):
            return ""
        touched = len(_touched(program, prior))
        if touched <= LARGEST:
            return ""
        return (
            f"it takes rows that touch {LARGEST:,} voxels at most, these touch "
            f"{touched:,}: choose a coarser grid (fewer voxels in r, θ and z) or fit "
            "fewer recordings"
        )

    def cost(self, program: Program) -> float:
        """Covariances of the touched voxels, and solves on the grid.

        0.3 s for 902 touched of 345,600 voxels, 5 s for 6,030 of 819,200, 27 s for
        18,113 of 2.8 million, 76 s for 33,477 of 5.4 million.
        """
        prior = program.known_prior
        if prior is None:
            return math.inf
        n = float(len(_touched(program, prior)))
        return 0.05 + 1.5e-6 * len(prior.target) + 1e-7 * n**2


def _touched(program: Program, prior: ProgramTerm) -> IntArray:
    """Voxels that the measured rows touch, in order."""
    beside = StackedTerms.of(terms_beside(program, prior), program.n_variables)
    touched = nonempty_columns(beside.matrix)
    return touched[touched < len(prior.target)]


SOLVERS = [Covariance()]

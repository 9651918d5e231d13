"""Prediction of the next working set of two fields by a small dense model.

Where no measured row touches the second field, only its prior determines it, and there
a limit is hardly ever active in the end. The active ones lie among the few hundred
voxels that measured rows touch, over which the problem is small and dense. With Γ the
inverse of half the Hessian of the objective there, a change of the multipliers z of
y ≥ l changes y by Γ times that. The minimiser y of one working set thus leads to the
next working set by a linear complementarity problem:

    y' = y + Γ (z' - z),   y' ≥ l,   z' ≥ 0,   z'ᵀ(y' - l) = 0.

An unknown c beside the fields is one more entry of y, and a bound of it one more limit.
In the prior's part of Γ a V-cycle replaces each L⁻¹, as in `preconditioner`, so Γ is
accurate to a few per cent only: the iteration is Newton's method with an approximate
derivative. `optimality` checks all limits of all voxels independently of this model.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.solvers.dual.pair_subproblem import PairRows
from ttus_opt.solvers.dual.preconditioner import ApproximateSchur
from ttus_opt.solvers.dual.solver import BlockPivoting
from ttus_opt.solvers.dual.system import DualSystem

#: Most voxels that measured rows may touch: two V-cycles each, and a dense matrix
MOST_VOXELS = 3000

#: Relative residual of the field that the unknown beside the fields causes [–]
MEAN_RTOL = 1e-4

#: Variance of that field over the prior's, so large that it is practically free [–]
FREE = 1e4

#: Rounding error of the prior's part, in single precision, over its mean variance [–]
ROUNDING = 1e-6

#: Exchanges of all wrong signs allowed without fewer wrong signs; exchanges at most
TRIES, MOST_EXCHANGES = 10, 300


@dataclass(frozen=True)
class TouchedLimits:
    """Response of the second field to multipliers where measured rows touch it.

    Attributes:
        voxels: The touched voxels, shape (k,).
        response: Γ, shape (k, k); (k + 1, k + 1) if an unknown c beside the fields
            causes a field, with c last.
        bounds: Bounds of c.
    """

    voxels: IntArray
    response: Array = field(repr=False)
    bounds: tuple[float, float]

    @classmethod
    def of(cls, rows: PairRows, limited: Mask) -> TouchedLimits | None:
        """The model of an objective; None if no or too many voxels are touched.

        Args:
            rows: The objective of x and y.
            limited: Voxels where y has a lower limit and no given value, (V,).
        """
        V = len(limited)
        touched = np.zeros(V, dtype=bool)
        touched[rows.rows.indices[rows.rows.data != 0.0] % V] = True
        voxels = np.flatnonzero(touched & limited & rows.laplace.free)
        k = len(voxels)
        if not 0 < k <= MOST_VOXELS:
            return None
        G = _prior_covariance(rows, voxels)
        G[np.diag_indices(k)] += ROUNDING * np.trace(G) / k
        ratio = rows.compliance[voxels[0]] / rows.compliance[V + voxels[0]]
        weighted = sp.diags_array(rows.root_weights) @ rows.rows
        x, y = (sp.csr_array(weighted[:, at]) for at in (voxels, V + voxels))
        mean = -rows.laplace.solve(rows.column[V:], rtol=MEAN_RTOL)[voxels]
        size = float(mean @ mean)
        if size > 0.0:
            mean = np.sqrt(FREE * np.trace(G) / size) * np.append(mean, 1.0)
            y = sp.csr_array(
                sp.hstack([y, sp.csr_array(rows.measured_column[:, None])])
            )
        try:
            return cls(voxels, _response(G, mean, ratio, x, y), rows.bounds)
        except np.linalg.LinAlgError:  # at large weights rounding dominates
            return None

    def active(
        self, slack: Array, multipliers: Array, beside: tuple[float, float]
    ) -> Mask | None:
        """Where y ≥ l is active next, shape (k,); None if rounding prevents it.

        Args:
            slack: y - l of the last working set, shape (k,).
            multipliers: z there, of half the objective, shape (k,).
            beside: c, and the derivative of half the objective in c.
        """
        response, k = self.response, len(self.voxels)
        if len(response) > k:
            (c, slope), (lower, upper) = beside, self.bounds
            if c == upper:  # turned into a lower limit
                response = response.copy()
                response[k], response[:k, k] = -response[k], -response[:k, k]
                response[k, k] *= -1.0
            at = (upper - c, -slope) if c == upper else (c - lower, slope)
            slack, multipliers = np.append(slack, at[0]), np.append(multipliers, at[1])
        constant = slack - response @ multipliers
        found = complementary(response, constant, multipliers != 0.0)
        return None if found is None else found[:k]


def _response(
    prior: Array, mean: Array, ratio: float, x: sp.csr_array, y: sp.csr_array
) -> Array:
    """Γ: the posterior covariance of y and c, for measurement noise of variance 1.

    First the posterior covariance of the first field, then that of the second and c,
    whose prior covariance is G + m mᵀ.

    Args:
        prior: G, prior covariance of the second field, shape (k, k).
        mean: m, the field that c causes and c itself, shape (k + 1,); zeros (k,) if it
            causes none.
        ratio: ρ, variance of the first field over that of the second [–].
        x: X, measured rows of the first field, shape (m, k).
        y: Y, measured rows of the second and of c, shape (m, k + 1) or (m, k).
    """
    k = len(prior)
    whole = np.outer(mean, mean)
    whole[:k, :k] += prior
    of_x, of_y, of_both = (
        (one.T @ other).toarray() for one, other in ((x, x), (y, y), (x, y))
    )
    follows = _posterior(ratio * prior, of_x)
    left = of_y - of_both.T @ follows @ of_both
    return _posterior(whole, (left + left.T) / 2.0)


def _posterior(covariance: Array, information: Array) -> Array:
    """(G⁻¹ + H)⁻¹ for covariance G and information H, shape (k, k) each."""
    root = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
    inner = np.eye(len(root)) + root.T @ information @ root
    factor = scipy.linalg.cholesky(inner, lower=True, check_finite=False)
    half = scipy.linalg.solve_triangular(factor, root.T, lower=True, check_finite=False)
    return np.asarray(half.T @ half)


def _prior_covariance(rows: PairRows, voxels: IntArray) -> Array:
    """Approximation of L⁻¹ ω L⁻ᵀ of the second field at some voxels, shape (k, k)."""
    V, k = len(rows.laplace.free), len(voxels)
    selected = sp.csr_array((np.ones(k), voxels, np.arange(k + 1)), shape=(k, V))
    system = DualSystem(rows.laplace, rows.compliance[V:], selected, np.ones(k))
    approximate = ApproximateSchur(system)
    unit, G = np.zeros(k), np.empty((k, k))
    for j in range(k):
        unit[j] = 1.0
        G[j] = approximate.apply(unit) - unit
        unit[j] = 0.0
    return np.asarray((G + G.T) / 2.0)


def complementary(matrix: Array, constant: Array, start: Mask) -> Mask | None:
    """Where z > 0 in the solution of z ≥ 0, M z + c ≥ 0, zᵀ(M z + c) = 0.

    Args:
        matrix: M, positive definite, shape (k, k).
        constant: c, shape (k,).
        start: Where z may differ from zero at first, shape (k,).

    Returns:
        Mask of z > 0, shape (k,); after `MOST_EXCHANGES` that with the fewest wrong
        signs. None if rounding makes a submatrix of M indefinite.
    """
    active, pivoting = start, BlockPivoting(TRIES)
    for _ in range(MOST_EXCHANGES):
        at = np.flatnonzero(active)
        # not `scipy.linalg.solve`, which warns if M is ill-conditioned, as with heavy
        # weights: the signs are still good enough, and are checked exactly later
        try:
            factor = scipy.linalg.cho_factor(matrix[np.ix_(at, at)], check_finite=False)
        except np.linalg.LinAlgError:
            return None
        z = -scipy.linalg.cho_solve(factor, constant[at], check_finite=False)
        wrong = matrix[:, at] @ z + constant < 0.0
        wrong[at] = z < 0.0
        following = pivoting.following(active, wrong)
        if following is None:
            break
        active = following
    return pivoting.best

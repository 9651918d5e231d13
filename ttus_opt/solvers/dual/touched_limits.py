"""The next working set of two fields, by a small model of the limits that can bind.

Where no measured row touches the second field its prior alone holds it, and there a
limit hardly ever stays active: those that do lie among the few hundred voxels that
measured rows touch. Over these the problem is small and dense. With Γ the inverse of
half the objective's second derivative there, a change of the multipliers z of y ≥ l
moves y by Γ times that change, so that the minimiser y of one working set leads to the
next one by a linear complementarity problem:

    y' = y + Γ (z' - z),   y' ≥ l,   z' ≥ 0,   z'ᵀ(y' - l) = 0.

In the prior's part of Γ a V-cycle stands for each L⁻¹, as in `preconditioner`; Γ errs
by a few per cent, and so does the next working set, whose minimiser leads to a better
one: Newton's method with an approximate derivative. All limits of all voxels are
judged by what `optimality` finds, not by this.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.solvers.dual.pair_subproblem import PairRows
from ttus_opt.solvers.dual.preconditioner import ApproximateSchur
from ttus_opt.solvers.dual.system import DualSystem

#: Most voxels that measured rows may touch: two V-cycles each, and a dense matrix
MOST_VOXELS = 3000

#: Relative residual of the field that the unknown beside the fields makes
MEAN_RTOL = 1e-4

#: Variance of that field over the prior's: it is as good as free [–]
FREE = 1e4

#: Rounding of the prior's part, in single precision, over its mean variance [–]
ROUNDING = 1e-6

#: Exchanges of all wrong signs that may fail to leave fewer, and exchanges at most
TRIES, MOST_EXCHANGES = 10, 300


@dataclass(frozen=True)
class TouchedLimits:
    """How the second field answers to multipliers where measured rows touch it.

    Attributes:
        voxels: Those, shape (k,).
        response: Γ, shape (k, k).
    """

    voxels: IntArray
    response: Array = field(repr=False)

    @classmethod
    def of(cls, rows: PairRows, limited: Mask) -> TouchedLimits | None:
        """The model of an objective; None where there is nothing or too much to model.

        Args:
            rows: The objective of x and y.
            limited: Voxels where y has a lower limit, and no given value, (V,).
        """
        V = len(limited)
        touched = np.zeros(V, dtype=bool)
        touched[rows.rows.indices[rows.rows.data != 0.0] % V] = True
        voxels = np.flatnonzero(touched & limited & rows.laplace.free)
        k = len(voxels)
        if not 0 < k <= MOST_VOXELS:
            return None
        G = _prior_covariance(rows, voxels)
        ratio = rows.compliance[voxels[0]] / rows.compliance[V + voxels[0]]
        weighted = sp.diags_array(rows.root_weights) @ rows.rows
        x, y = (sp.csr_array(weighted[:, at]) for at in (voxels, V + voxels))
        of_x, of_y, of_both = (
            (one.T @ other).toarray() for one, other in ((x, x), (y, y), (x, y))
        )
        mean = rows.laplace.solve(rows.column[V:], rtol=MEAN_RTOL)[voxels]
        try:
            # of y beside an x that follows as measured rows and its prior have it
            follows = _posterior(ratio * G, of_x)
            told = of_y - of_both.T @ follows @ of_both
            size = float(mean @ mean)
            if size > 0.0:
                G += (FREE * np.trace(G) / size) * np.outer(mean, mean)
            return cls(voxels, _posterior(G, (told + told.T) / 2.0))
        except np.linalg.LinAlgError:  # weights so large that rounding is all
            return None

    def active(self, slack: Array, multipliers: Array) -> Mask | None:
        """Where y ≥ l is active next, shape (k,); None where rounding hides it.

        Args:
            slack: y - l of the last working set, shape (k,).
            multipliers: z there, of half the objective, shape (k,).
        """
        constant = slack - self.response @ multipliers
        return complementary(self.response, constant, multipliers != 0.0)


def _posterior(covariance: Array, information: Array) -> Array:
    """(G⁻¹ + H)⁻¹, positive definite, of G and H, shape (k, k) each."""
    k = len(covariance)
    jitter = ROUNDING * np.trace(covariance) / k
    root = scipy.linalg.cholesky(
        covariance + jitter * np.eye(k), lower=True, check_finite=False
    )
    inner = np.eye(k) + root.T @ information @ root
    factor = scipy.linalg.cholesky(inner, lower=True, check_finite=False)
    half = scipy.linalg.solve_triangular(factor, root.T, lower=True, check_finite=False)
    return np.asarray(half.T @ half)


def _prior_covariance(rows: PairRows, voxels: IntArray) -> Array:
    """L⁻¹ ω L⁻ᵀ of the second field between voxels, roughly, shape (k, k)."""
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
    """Where z > 0 in z ≥ 0, M z + c ≥ 0, zᵀ(M z + c) = 0; M is positive definite.

    Block principal pivoting; where the number of wrong signs does not fall, one at a
    time by Murty's rule (Júdice and Pires, Comput. Oper. Res. 21, 1994).

    Args:
        matrix: M, shape (k, k).
        constant: c, shape (k,).
        start: Where z may differ from zero at first, shape (k,).

    Returns:
        Those; after `MOST_EXCHANGES` those of the fewest wrong signs. None where a part
        of M is not positive definite but for rounding.
    """
    active = best = start.copy()
    fewest, left = len(constant) + 1, TRIES
    for _ in range(MOST_EXCHANGES):
        at = np.flatnonzero(active)
        # no `scipy.linalg.solve`: it warns of an ill-conditioned M, as at heavy
        # weights, where signs still tell enough of what is judged exactly afterwards
        try:
            factor = scipy.linalg.cho_factor(matrix[np.ix_(at, at)], check_finite=False)
        except np.linalg.LinAlgError:
            return None
        z = -scipy.linalg.cho_solve(factor, constant[at], check_finite=False)
        wrong = matrix[:, at] @ z + constant < 0.0
        wrong[at] = z < 0.0
        count = int(np.count_nonzero(wrong))
        if count < fewest:
            best, fewest, left = active, count, TRIES
        elif left:
            left -= 1
        else:
            wrong[: np.flatnonzero(wrong)[-1]] = False
        if count == 0:
            break
        active = active ^ wrong
    return best

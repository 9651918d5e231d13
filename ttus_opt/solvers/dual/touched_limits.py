"""The next working set of two fields, by a small model of the limits that can bind.

Where no measured row touches the second field its prior alone holds it, and there a
limit hardly ever stays active: those that do lie among the few hundred voxels that
measured rows touch. Over these the problem is small and dense. With Γ the inverse of
half the objective's second derivative there, a change of the multipliers z of y ≥ l
moves y by Γ times that change, so that the minimiser y of one working set leads to the
next one by a linear complementarity problem:

    y' = y + Γ (z' - z),   y' ≥ l,   z' ≥ 0,   z'ᵀ(y' - l) = 0.

An unknown c beside the fields is one more entry of y, and a bound of it one more limit.
In the prior's part of Γ a V-cycle stands for each L⁻¹, as in `preconditioner`; Γ errs
by a few per cent, and so does the next working set, whose minimiser leads to a better
one: Newton's method with an approximate derivative. All limits of all voxels are
judged by what `optimality` finds, not by this.
"""

from __future__ import annotations

from collections.abc import Callable
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

#: Random combinations at a time [–]
BLOCK = 64

#: Where more than this part of the voxels' number do not do, none are left out [–]
FEW = 3

#: What measurements left out may tell, as their covariance over their noise's [–]
UNTOLD = 1e-2

#: Exchanges of all wrong signs that may fail to leave fewer, and exchanges at most
TRIES, MOST_EXCHANGES = 10, 300


@dataclass(frozen=True)
class TouchedLimits:
    """How the second field answers to multipliers where measured rows touch it.

    Attributes:
        voxels: Those, shape (k,).
        response: Γ, shape (k, k); of the unknown c beside the fields as well, as the
            last, where it makes a field, (k + 1, k + 1).
        bounds: Of c.
    """

    voxels: IntArray
    response: Array = field(repr=False)
    bounds: tuple[float, float]

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
        except np.linalg.LinAlgError:  # weights so large that rounding is all
            return None

    def active(
        self, slack: Array, multipliers: Array, beside: tuple[float, float]
    ) -> Mask | None:
        """Where y ≥ l is active next, shape (k,); None where rounding hides it.

        Args:
            slack: y - l of the last working set, shape (k,).
            multipliers: z there, of half the objective, shape (k,).
            beside: c, and the slope of half the objective in c.
        """
        response, k = self.response, len(self.voxels)
        if len(response) > k:
            (c, slope), (lower, upper) = beside, self.bounds
            if c == upper:  # its limit as one from below
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
    """Γ: the covariance of y, and of c, after measurements with noise of variance 1.

    With G' = G + m mᵀ, where G has no part in c, and Q the combinations of measured
    rows that tell anything,

        Γ = G' - G'YᵀQ (I + Qᵀ(ρ X G Xᵀ + Y G'Yᵀ)Q)⁻¹ QᵀY G'.

    Where these are many, no rows are left out, and what they tell of the first field is
    eliminated before: its covariance follows, and then that of the second.

    Args:
        prior: G, covariance of the second field before, shape (k, k).
        mean: m, the field that c makes and c itself, shape (k + 1,); zeros (k,) where
            it makes none.
        ratio: ρ, variance of the first field over that of the second [–].
        x: X, measured rows of the first field, shape (m, k).
        y: Y, of the second and of c, shape (m, k + 1) or (m, k).
    """
    k = len(prior)

    def measured(ends: Array) -> tuple[Array, Array]:
        """QᵀY G' and Qᵀ(ρ X G Xᵀ + Y G'Yᵀ) of some combinations Q."""
        own = np.asarray(ends.T @ y)
        moved = np.outer(own @ mean, mean)
        moved[:, :k] += own[:, :k] @ prior
        first = ratio * np.asarray(ends.T @ x) @ prior
        return moved, np.asarray(x @ first.T + y @ moved.T).T

    whole = np.outer(mean, mean)
    whole[:k, :k] += prior
    most = k // FEW
    told = telling(lambda ends: measured(ends)[1].T, x.shape[0], most)
    if told is None:
        of_x, of_y, of_both = (
            (one.T @ other).toarray() for one, other in ((x, x), (y, y), (x, y))
        )
        follows = _posterior(ratio * prior, of_x)
        left = of_y - of_both.T @ follows @ of_both
        return _posterior(whole, (left + left.T) / 2.0)
    moved, kernel = measured(told)
    inner = np.eye(told.shape[1]) + kernel @ told
    factor = scipy.linalg.cholesky(
        (inner + inner.T) / 2.0, lower=True, check_finite=False
    )
    half = scipy.linalg.solve_triangular(factor, moved, lower=True, check_finite=False)
    return np.asarray(whole - half.T @ half)


def telling(operator: Callable[[Array], Array], n: int, most: int) -> Array | None:
    """Orthonormal columns, (n, r), off which an operator does next to nothing.

    The range of random combinations (Halko, Martinsson, Tropp, SIAM Rev. 53, 2011),
    a block at a time: what one adds tells what those before it have missed.

    Args:
        operator: Symmetric positive semidefinite, (n, k) to (n, k).
        n: Its size.
        most: Most columns; None is the answer where these do not do.
    """
    rng = np.random.default_rng(0)
    found = np.zeros((n, 0))
    while True:
        block = operator(rng.standard_normal((n, BLOCK)))
        for _ in range(2):
            block -= found @ (found.T @ block)
        if np.linalg.norm(block) <= UNTOLD * np.sqrt(BLOCK):
            return found
        if found.shape[1] + BLOCK > min(n, most):
            return None
        block = np.linalg.qr(block)[0]
        block -= found @ (found.T @ block)  # what rounding left of them is large now
        found = np.hstack([found, np.linalg.qr(block)[0]])


def _posterior(covariance: Array, information: Array) -> Array:
    """(G⁻¹ + H)⁻¹, positive definite, of G and H, shape (k, k) each."""
    root = scipy.linalg.cholesky(covariance, lower=True, check_finite=False)
    inner = np.eye(len(root)) + root.T @ information @ root
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

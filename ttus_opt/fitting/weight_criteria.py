"""What measurements alone say of weights: evidence, GCV, and presses left out.

With the rows' misfit d = t - D p₀ to the prior, W the roots of their weights, and
C = D L⁻¹ω L⁻ᵀDᵀ in the form KᵀK of a reduced basis, the marginal covariance of d is
σ²(W⁻² + C). All criteria need B = K W and R = (1 + WCW)⁻¹ = 1 - Bᵀ(1 + BBᵀ)⁻¹B only:

- evidence: σ² = J/m with J = dᵀW R W d the likeliest for these weights, so that
  log p(d) = -½ (m log(2π J/m) + log det(W⁻² + C) + m)
  (Rasmussen and Williams, 2006, eq. 2.30);
- generalised cross-validation: m ‖R W d‖²/(tr R)² over the weights' geometric mean
  (Golub, Heath and Wahba, Technometrics 21, 1979);
- left out: the error of what is predicted for the rows F of a press by all others,
  W_F⁻¹ (R_FF)⁻¹ (R W d)_F, exact without another fit.

Frames of one press are alike, so that leaving out single frames, as GCV does in effect,
tells little: left out are presses, runs of frames in contact.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import scipy.linalg

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.scene import Scene

#: Name, unit and meaning, in the order of `Criteria.values`
TOLD = {
    "log_evidence": ("1", "logarithm of the marginal likelihood of the measurements"),
    "gcv": ("N2", "score of generalised cross-validation, of all rows in N"),
    "left_out_force_error": (
        "N",
        "mean error of the force's magnitude over frames of presses left out in turn",
    ),
}


#: Least root of a weight that is divided by [–]
LEAST_ROOT = 1e-12


@dataclass(frozen=True)
class Criteria:
    """Rows of a problem as the criteria see them.

    Attributes:
        press: Which press a row belongs to, shape (m,) [–].
        force_rows: Rows of force, three of a frame one after the other, shape (f,) [–].
        force: What was measured there, shape (f,) [N].
    """

    press: IntArray = field(repr=False)
    force_rows: IntArray = field(repr=False)
    force: Array = field(repr=False)

    def values(self, images: Array, misfit: Array, root: Array) -> dict[str, float]:
        """All criteria for one set of weights, by name.

        Args:
            images: K, shape (k, m).
            misfit: d, shape (m,).
            root: Diagonal of W, shape (m,) [–].
        """
        m = len(misfit)
        if m == 0:
            return dict.fromkeys(TOLD, np.nan)
        lower, half, rest = _factorised(images, misfit, root)
        size = float(rest @ (root * misfit))
        determinant = 2.0 * float(np.log(np.diag(lower)).sum() - np.log(root).sum())
        trace = m - float((half**2).sum())
        evidence = -0.5 * (m * np.log(2.0 * np.pi * size / m) + determinant + m)
        scale = np.exp(2.0 * np.log(root).mean())
        gcv = m * float(rest @ rest) / trace**2 / scale
        left_out = self._magnitude_error(half, rest, root)
        return dict(zip(TOLD, (float(evidence), gcv, left_out), strict=True))

    def left_out(self, images: Array, misfit: Array, root: Array) -> Array:
        """Force that all other presses predict for every frame, (f/3, 3) [N].

        With one press that is the prior's.

        Args:
            images: As of `values`.
            misfit: As of `values`.
            root: As of `values`; a force without weight counts as next to nothing.
        """
        root = np.maximum(root, LEAST_ROOT)
        _, half, rest = _factorised(images, misfit, root)
        return self._predicted(half, rest, root)

    def _predicted(self, half: Array, rest: Array, root: Array) -> Array:
        error = left_out_errors(half, rest, self.press) / root
        return (self.force - error[self.force_rows]).reshape(-1, 3)

    def _magnitude_error(self, half: Array, rest: Array, root: Array) -> float:
        """Mean | ‖f‖ - ‖f̂‖ | over frames of presses left out; NaN with one press."""
        if len(np.unique(self.press)) < 2 or not len(self.force):
            return np.nan
        predicted = self._predicted(half, rest, root)
        lengths = (
            np.linalg.norm(v.reshape(-1, 3), axis=1) for v in (self.force, predicted)
        )
        measured, told = lengths
        return float(np.abs(measured - told).mean())


def _factorised(
    images: Array, misfit: Array, root: Array
) -> tuple[Array, Array, Array]:
    """Factor of 1 + BBᵀ, X with R = 1 - XᵀX, and R W d."""
    weighted = images * root
    gram = weighted @ weighted.T
    gram[np.diag_indices_from(gram)] += 1.0
    lower = np.asarray(np.linalg.cholesky(gram), dtype=np.float64)
    half = scipy.linalg.solve_triangular(lower, weighted, lower=True)
    return lower, half, root * misfit - half.T @ (half @ (root * misfit))


def left_out_errors(half: Array, rest: Array, press: IntArray) -> Array:
    """Weighted errors of what all other presses predict for every row, shape (m,).

    Args:
        half: X with R = 1 - XᵀX, shape (k, m).
        rest: R W d, shape (m,).
        press: Which press a row belongs to, shape (m,) [–].
    """
    error = np.empty_like(rest)
    for number in np.unique(press):
        at = np.flatnonzero(press == number)
        error[at] = _without(half[:, at], rest[at])
    return error


def _without(half: Array, rest: Array) -> Array:
    """Solve (1 - XᵀX) e = r by the smaller of two systems, X of shape (k, n)."""
    k, n = half.shape
    if n <= k:
        return np.asarray(scipy.linalg.solve(np.eye(n) - half.T @ half, rest))
    inner = scipy.linalg.solve(np.eye(k) - half @ half.T, half @ rest)
    return np.asarray(rest + half.T @ inner)


def presses(scene: Scene) -> IntArray:
    """Number of the press every frame belongs to, shape (T,).

    A press is a run of frames in contact within a recording; between two of them the
    probe has left the skin.
    """
    return runs(scene.rows.contact_points > 0, scene.trajectory.segment)


def runs(touching: Mask, segment: IntArray) -> IntArray:
    """Number of the run every frame belongs to, in contact or in the air, shape (T,).

    Args:
        touching: Whether a frame is in contact, shape (T,).
        segment: Which recording it is of, shape (T,) [–].
    """
    begins = (np.diff(touching.astype(np.int8)) != 0) | (np.diff(segment) != 0)
    return np.concatenate([[0], np.cumsum(begins)]).astype(np.int64)


def criteria_of(scene: Scene, terms: dict[str, int], told: Mask) -> Criteria:
    """Which rows of a problem are whose.

    Args:
        scene: Where they were measured.
        terms: Rows per measured term, by name, in their order; three per frame.
        told: Rows that say something of the field, shape (m,).
    """
    frames = np.concatenate(
        [*(np.repeat(np.arange(n // 3), 3) for n in terms.values()), np.zeros(0, int)]
    )
    start = 0
    force = np.zeros(len(told), dtype=bool)
    measured = np.zeros(len(told))
    for name, n in terms.items():
        if name == "force":
            force[start : start + n] = True
            measured[start : start + n] = scene.f
        start += n
    at = np.flatnonzero(force[told])
    return Criteria(presses(scene)[frames[told]], at, measured[told][at])

"""Criteria for weights, from the measurements alone: evidence, GCV, presses left out.

With the rows' misfit d = t - D p₀ to the prior, W the roots of their weights, and
C = D L⁻¹Ω L⁻ᵀDᵀ in the form KᵀK of a reduced basis, the marginal covariance of d is
σ²(W⁻² + C). All criteria follow from B = K W and R = (1 + BᵀB)⁻¹
(`gaussian.conditioned`):

- evidence: with σ² = J/m, the most likely for these weights, and J = dᵀW R W d,
  log p(d) = -½ (m log(2π J/m) + log det(W⁻² + C) + m)
  (Rasmussen and Williams, 2006, eq. 2.30);
- generalised cross-validation: m ‖R W d‖²/(tr R)² over the weights' geometric mean
  (Golub, Heath and Wahba, Technometrics 21, 1979);
- left out: the error of predicting the rows F of one press from all others,
  W_F⁻¹ (R_FF)⁻¹ (R W d)_F, exact without another fit.

Frames of one press are alike, so that leaving out single frames, as GCV does in effect,
says little: whole presses (runs of frames in contact) are left out.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.gaussian.conditioned import ByImages

#: Unit and meaning of every criterion, by name, in the order of `Criteria.values`
CRITERIA = {
    "log_evidence": ("1", "logarithm of the marginal likelihood of the measurements"),
    "gcv": ("N2", "score of generalised cross-validation, of all rows in N"),
    "left_out_force_error": (
        "N",
        "mean error of the force's magnitude over frames of presses left out in turn",
    ),
}


@dataclass(frozen=True)
class Criteria:
    """The rows of a problem, as the criteria need them.

    Attributes:
        press: Which press a row belongs to, shape (m,) [–].
        force_rows: Rows of force, three per frame, consecutive, shape (f,) [–].
        force: Measured forces there, shape (f,) [N].
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
            return dict.fromkeys(CRITERIA, np.nan)
        data = ByImages.of(images * root, root * misfit)
        rest, log_root = data.multipliers, np.log(root)
        size = m * np.log(2.0 * np.pi * data.square / m) + data.log_determinant
        evidence = -0.5 * float(size - 2.0 * log_root.sum() + m)
        trace = m - float((data.half**2).sum())
        gcv = m * float(rest @ rest) / trace**2 / np.exp(2.0 * log_root.mean())
        left_out = self._magnitude_error(data, root)
        return dict(zip(CRITERIA, (evidence, float(gcv), left_out), strict=True))

    def _magnitude_error(self, data: ByImages, root: Array) -> float:
        """Mean | ‖f‖ - ‖f̂‖ | over frames of presses left out; NaN with one press."""
        if len(np.unique(self.press)) < 2 or not len(self.force):
            return np.nan
        error = (data.left_out(self.press) / root)[self.force_rows]
        both = self.force, self.force - error
        measured, rendered = (np.linalg.norm(v.reshape(-1, 3), axis=1) for v in both)
        return float(np.abs(measured - rendered).mean())


def criteria_of(scene: Scene, terms: dict[str, int], informative: Mask) -> Criteria:
    """The criteria of a problem's rows.

    Args:
        scene: A scene with the measurements.
        terms: Rows per measured term, by name, in their order; three per frame.
        informative: Rows that depend on the field, shape (m,).
    """
    frames = np.concatenate(
        [*(np.repeat(np.arange(n // 3), 3) for n in terms.values()), np.zeros(0, int)]
    )
    start = 0
    force = np.zeros(len(informative), dtype=bool)
    measured = np.zeros(len(informative))
    for name, n in terms.items():
        if name == "force":
            force[start : start + n] = True
            measured[start : start + n] = scene.f
        start += n
    at = np.flatnonzero(force[informative])
    press = scene.presses[frames[informative]]
    return Criteria(press, at, measured[informative][at])

"""How well weights predict what was measured at places left out.

With the rows' misfit d = t - s u to the prior's mean times a scale s, the prediction of
the rows of one place from all others has a closed form (`gaussian.conditioned`); s is
that of generalised least squares. A place counts as one observation of a term's error,
whatever its number of frames, so that over P places

    log p = -½ Σ P log (mean square of the errors of a term)

stands for the likelihood of the weights: that of errors whose size is not known. Weak
priors keep weights that the places hardly tell near usual ones. See
docs/method/identification.md, "Tuning".

Other criteria, for comparison (`criteria`), take the m rows of all frames for
independent. With B and S of weighted rows, W their roots, J = dᵀS⁻¹d:

- evidence, with the most likely size of the noise for these weights,
  log p(d) = -½ (m log(2π J/m) + log det(W⁻² S) + m)
  (Rasmussen and Williams, 2006, eq. 2.30);
- generalised cross-validation, m ‖S⁻¹d‖²/(tr S⁻¹)² over the weights' geometric mean
  (Golub, Heath and Wahba, Technometrics 21, 1979).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.fitting.weights.tuning_rows import BasisRows
from ttus_opt.gaussian.conditioned import ByImages
from ttus_opt.gaussian.posterior_mode import posterior_mode

#: Prior variance of a force row over that of its noise: median, and standard deviation
#: of its logarithm. Tissue varies by 40 %, which is 1 N of 3 N, and a frame is accurate
#: to 0.15 N; frames of one press repeat each other's errors, so that each counts less
SIGNAL = (3.0, 2.0)

#: Weight of a further term over the first's, likewise [–]
RATIO = (1.0, 1.5)

#: Prior standard deviation of a coefficient such as friction, around 0 [–]
COEFFICIENT = 0.5

#: Largest distance from the medians, in prior standard deviations [–]
FARTHEST = 6.0

#: Most evaluations, and steps of the first term's weight at which the search may start
CALLS, STARTS = 60, (-2.0, -1.0, 1.0, 2.0, 3.0)

#: Step of the second differences, in prior standard deviations [–]
STEP = 0.3

#: Range of boundary scales, over the scene's own, and their largest relative standard
#: error; otherwise the scene's is kept [–]
SCALES, SCALE_ERROR = (0.5, 2.0), 0.2

#: Rows of one frame and term [–]
COMPONENTS = 3

#: Least mean square of a term's errors, over that of its measurements: rounding [–]
LEAST_SQUARE = 1e-12


#: Unit and meaning of every criterion, by name, in the order of `criteria`
CRITERIA = {
    "log_evidence": ("1", "logarithm of the marginal likelihood of the measurements"),
    "gcv": ("N2", "score of generalised cross-validation, of all rows in N"),
    "left_out_force_error": (
        "N",
        "mean error of the force's magnitude over frames of presses left out in turn",
    ),
}


@dataclass(frozen=True)
class Prediction:
    """What all other places predict with some weights.

    Attributes:
        errors: Measured minus predicted, shape (m,).
        scale: s [–].
        scale_error: Its standard error; NaN where it is not determined [–].
    """

    errors: Array = field(repr=False)
    scale: float
    scale_error: float


@dataclass(frozen=True)
class PlaceLeftOut:
    """Measured rows, of which one place is left out after the other.

    Attributes:
        rows: The rows over a basis.
        n_terms: Number of terms [–].
        variance: Mean prior variance of the first term's rows.
        largest: Largest signal to noise that the basis is made for [–].
        highest: Largest value of their coefficient; 0 without one.
        free_scale: Whether the scale of the prior's mean is estimated.
    """

    rows: BasisRows
    n_terms: int
    variance: float
    largest: float
    highest: float = 0.0
    free_scale: bool = False

    def predicted(self, weights: Array, coefficient: float = 0.0) -> Prediction:
        """The errors with some weights by term.

        Args:
            weights: λ by term, shape (terms,) [–].
            coefficient: Of the rows.
        """
        rows = self.rows.at(coefficient)
        root = np.sqrt(np.maximum(weights, 1e-300)[rows.term] * rows.every)
        both = root[:, None] * np.stack([rows.target, rows.base], axis=1)
        data = ByImages.of(rows.images * root, both[:, 0])
        rest = data.solve(both)
        off = data.left_out(rows.place, rest)
        t, u = (off / root[:, None]).T
        if not self.free_scale:
            return Prediction(t - u, 1.0, 0.0)
        (tt, tu), (_, uu) = both.T @ rest
        if uu <= 0.0:
            return Prediction(t - u, 1.0, np.nan)
        scale = float(tu / uu)
        square = max(float(tt - 2.0 * scale * tu + scale**2 * uu), 0.0) / len(t)
        # frames of one place repeat each other's errors
        alike = max(len(t) / (COMPONENTS * self.n_terms * self.places), 1.0)
        error = float(np.sqrt(square * alike / uu))
        low, high = SCALES
        if error > SCALE_ERROR * abs(scale) or not low <= scale <= high:
            return Prediction(t - u, 1.0, np.nan)
        return Prediction(t - scale * u, scale, error)

    @cached_property
    def places(self) -> int:
        """Number of places [–]."""
        return len(np.unique(self.rows.place))

    def log_density(self, weights: Array, coefficient: float = 0.0) -> float:
        """The log p above; arguments as for `predicted`."""
        term, target = self.rows.term, self.rows.target
        errors, count = self.predicted(weights, coefficient).errors, np.bincount(term)
        square = np.bincount(term, errors**2) / count
        least = LEAST_SQUARE * np.bincount(term, target**2) / count
        square = np.maximum(np.maximum(square, least), 1e-300)
        return -0.5 * self.places * float(np.log(square).sum())

    def values(self, steps: Array) -> tuple[Array, float]:
        """Weights by term and coefficient at steps from the priors' medians."""
        steps = np.clip(steps, -FARTHEST, FARTHEST)
        n = self.n_terms
        signal = min(SIGNAL[0] * math.exp(SIGNAL[1] * steps[0]), self.largest)
        ratio = np.concatenate([[1.0], RATIO[0] * np.exp(RATIO[1] * steps[1:n])])
        weights = np.minimum(signal * ratio, self.largest) / self.variance
        coefficient = COEFFICIENT * float(steps[n]) if len(steps) > n else 0.0
        return weights, min(max(coefficient, 0.0), self.highest)

    def best(self, starts: Sequence[Array] = ()) -> tuple[Array, Array]:
        """Most likely steps and their posterior standard deviations, shape (n,) each.

        Args:
            starts: Weights from which the search may start too, shape (terms,) each.
        """
        n = self.n_terms + (self.highest > 0.0)

        def log_density(steps: Array) -> float:
            return self.log_density(*self.values(steps))

        begins = [np.eye(n)[0] * step for step in STARTS]
        begins += [self._steps(weights, n) for weights in starts]
        mode = posterior_mode(log_density, n, CALLS, begins)
        top = np.clip(mode.steps, -FARTHEST, FARTHEST)

        def cost(steps: Array) -> float:
            return 0.5 * float(steps @ steps) - log_density(steps)

        middle, spread = cost(top), np.empty(n)
        for i, step in enumerate(STEP * np.eye(n)):
            bend = (cost(top + step) - 2.0 * middle + cost(top - step)) / STEP**2
            # the prior alone has curvature 1: much less is rounding, or no minimum
            spread[i] = 1.0 / math.sqrt(max(bend, 0.25))
        return top, spread

    def _steps(self, weights: Array, n: int) -> Array:
        """The steps of given weights."""
        out = np.zeros(n)
        positive = np.maximum(weights, 1e-12 / self.variance)
        out[0] = math.log(positive[0] * self.variance / SIGNAL[0]) / SIGNAL[1]
        out[1 : self.n_terms] = np.log(positive[1:] / positive[0] / RATIO[0]) / RATIO[1]
        return np.clip(out, -FARTHEST, FARTHEST)


def criteria(rows: BasisRows, root: Array) -> dict[str, float]:
    """`CRITERIA` for one set of weights; NaN where there is nothing to tell.

    Args:
        rows: Measured rows, of which the first term's are forces, three per frame.
        root: Roots of their weights, shape (m,) [–].
    """
    m = len(rows.target)
    if m == 0:
        return dict.fromkeys(CRITERIA, np.nan)
    data = ByImages.of(rows.images * root, root * (rows.target - rows.base))
    log_root = np.log(root)
    size = m * np.log(2.0 * np.pi * data.square / m) + data.log_determinant
    evidence = -0.5 * float(size - 2.0 * log_root.sum() + m)
    trace = m - float((data.half**2).sum())
    rest = float(data.multipliers @ data.multipliers)
    gcv = m * rest / trace**2 / float(np.exp(2.0 * log_root.mean()))
    first, error = rows.term == 0, np.nan
    if len(np.unique(rows.place)) > 1 and first.any():
        off = (data.left_out(rows.place) / root)[first]
        both = rows.target[first], rows.target[first] - off
        told, found = (np.linalg.norm(v.reshape(-1, 3), axis=1) for v in both)
        error = float(np.abs(told - found).mean())
    return dict(zip(CRITERIA, (evidence, gcv, error), strict=True))

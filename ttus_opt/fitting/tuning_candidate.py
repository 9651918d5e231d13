"""The likeliest hyperparameters of one formulation, by the evidence of its rows.

These are the weights of its measured terms, how much of their errors is sensor noise,
the correlation time of the rest, a coefficient of its rows such as friction, and
options of the formulation; the boundary scale follows in closed form. See
docs/method.md, "Tuning".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize

from ttus_opt.arrays import Array
from ttus_opt.fitting.hyperparameters import (
    DETERMINED,
    Hyperparameter,
    Maximum,
    Prior,
    maximise_by_slope,
)
from ttus_opt.fitting.marginal_likelihood import (
    Evidence,
    EvidenceSlope,
    MarginalLikelihood,
    MeasuredSeries,
)
from ttus_opt.fitting.series_noise import SeriesNoise
from ttus_opt.fitting.tuning_series import MOST_FRAMES, TuningRows
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import BOUNDARY_SCALE, Scene

#: Prior variance of a force row over that of its noise: median, and standard deviation
#: of its logarithm. Tissue varies by 40 %, which is 1 N of 3 N, and a frame is accurate
#: to 0.15 N [–]
SIGNAL = (64.0, 2.0)

#: Name of that hyperparameter, which stands for the first term's weight
SIGNAL_TO_NOISE = "signal_to_noise"

#: Weight of a further term over the first's, likewise [–]
RATIO = (1.0, 1.5)

#: Variance of a term's sensor noise over that of its model errors, likewise: 0.08 N and
#: 0.16 N [–]
SENSOR = (0.25, 1.5)

#: Correlation time of model errors, likewise; in half a second a hand presses by some
#: millimetres [s]
CORRELATION_TIME = (0.5, 1.0)

#: Prior standard deviation of a coefficient such as friction, around 0 [–]
COEFFICIENT = 0.5

#: Largest signal to noise of the first basis; factor and number of enlargements [–]
FIRST_SIGNAL, LARGER, ENLARGEMENTS = 100.0, 30.0, 2

#: Trace of the covariance of the evidence's rows, in units of their noise, that a
#: condensed basis may miss: with a tenth of it the log evidence differs by 0.01 [–]
MISSING = 0.5

#: Range of boundary scales, over the scene's own, and their largest relative standard
#: error; otherwise the scene's is kept [–]
SCALES, SCALE_ERROR = (0.5, 2.0), 0.2

#: Options tuned beside the weights, by formulation, with a range over which their
#: logarithm is about uniform
VARIED: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "free_surface": {"skin": (1e-6, 1e-1)}
}

#: Weights are compared up to this relative difference [–]
ROUNDING = 1e-6

#: Most fits of an option, and its accuracy in prior standard deviations
OPTION_FITS, OPTION_ACCURACY = 8, 0.2


class KeptSeries:
    """Cache of series by basis, shared by formulations with the same measured rows.

    The rows of eq. 10 are those with drag at a coefficient of 0.

    Attributes:
        found: The last hyperparameters found with them, to start from.
    """

    def __init__(self) -> None:
        self.found: tuple[Hyperparameter, ...] = ()
        self._kept: list[tuple[TuningRows, float, MeasuredSeries]] = []

    def __call__(self, rows: TuningRows, weight: float) -> MeasuredSeries:
        """The series of some rows, for weights up to ``weight``."""
        for other, largest, series in self._kept:
            if weight <= largest * (1.0 + ROUNDING) and other.include(rows):
                return series if rows.coefficient else series.at(0.0)
        self._kept.append((rows, weight, rows.series(weight)))
        return self._kept[-1][2]


@dataclass(frozen=True)
class Candidate:
    """A formulation with its likeliest hyperparameters.

    Attributes:
        build: Builds it over a scene, with the chosen options; None for an object.
        declared: The formulation over the scene of the fit.
        rows: Its rows on the grid for tuning.
        variance: Mean prior variance of their first term [–].
        series: Its frames in contact, over the basis.
        maximum: Maximum of the evidence over the hyperparameters.
        largest: Largest weight that the basis is made for [–].
        varied: The chosen options.
    """

    build: Callable[[Scene], Formulation] | None
    declared: Formulation
    rows: TuningRows
    variance: float
    series: MeasuredSeries
    maximum: Maximum
    largest: float
    varied: tuple[Hyperparameter, ...] = ()

    @property
    def log_marginal(self) -> float:
        """The figure by which formulations are compared [–]."""
        return self.maximum.log_marginal

    @property
    def bears_coefficient(self) -> bool:
        """Whether the data determine its coefficient, if it has one."""
        if not self.rows.coefficient:
            return not self.declared.not_identifiable()
        last = self.maximum.found[-1]
        return last.determined and last.value > 0.0

    @property
    def free_scale(self) -> bool:
        """Whether the boundary scale is estimated."""
        return self.build is not None and _fits_scale(self.declared)

    @property
    def values(self) -> Values:
        """The likeliest hyperparameters."""
        found = np.array([h.value for h in self.maximum.found])
        return Values.of(found, len(self.rows.terms), self.variance)

    def reaching(self, weights: Array) -> MeasuredSeries:
        """The series at its coefficient, over a basis for these weights."""
        most, series = float(max(weights)), self.series
        if most > self.largest * (1.0 + ROUNDING):
            series = self.rows.series(most)
        return series.at(self.values.coefficient)

    def evidence(self) -> Evidence:
        """Evidence at the likeliest hyperparameters, with the boundary scale to use."""
        values = self.values
        series = thinned(self.series).at(values.coefficient)
        at = values.weights, values.noise
        if not self.free_scale:
            return series.evidence(*at, scale=1.0)
        free = series.evidence(*at)
        bears = free.scale_error <= SCALE_ERROR * abs(free.scale)
        if bears and SCALES[0] <= free.scale <= SCALES[1]:
            return free
        return replace(series.evidence(*at, scale=1.0), scale_error=np.nan)


@dataclass(frozen=True)
class Values:
    """Hyperparameters in the form of the evidence.

    Attributes:
        weights: λ by term [–].
        noise: Correlation of the errors.
        coefficient: Coefficient of the rows; 0 without one.
    """

    weights: Array
    noise: SeriesNoise
    coefficient: float

    @classmethod
    def of(cls, found: Array, n_terms: int, variance: float) -> Values:
        """From values in the order of `_priors`."""
        first = found[0] / variance
        weights = first * np.concatenate([[1.0], found[1:n_terms]])
        sensor, (time, *rest) = found[n_terms : 2 * n_terms], found[2 * n_terms :]
        noise = SeriesNoise(float(time), sensor)
        return cls(weights, noise, float(rest[0]) if rest else 0.0)

    @staticmethod
    def derivatives(slope: EvidenceSlope, found: Array) -> Array:
        """Derivatives by these values."""
        n, by = len(slope.log_weights), slope.log_weights
        out = [by.sum() / found[0], *(by[1:] / found[1:n]), *slope.sensor]
        out.append(slope.correlation_time)
        return np.array([*out, slope.coefficient][: len(found)])


def ratio_name(term: str, first: str) -> str:
    """Name of the hyperparameter that is a term's weight over the first's."""
    return f"{term}_over_{first}_weight"


def _priors(rows: TuningRows) -> list[Prior]:
    """In the order of `Values.of`."""
    first, *others = rows.terms
    priors = [Prior(SIGNAL_TO_NOISE, *SIGNAL)]
    priors += [Prior(ratio_name(name, first), *RATIO) for name in others]
    priors += [Prior(f"{name}_sensor_over_model_error", *SENSOR) for name in rows.terms]
    priors.append(Prior("correlation_time", *CORRELATION_TIME, unit="s"))
    if rows.coefficient:
        priors.append(
            Prior(rows.coefficient, 0.0, COEFFICIENT, linear=True, highest=rows.highest)
        )
    return priors


def candidate(
    formulation: str | Path | Formulation,
    scene: Scene,
    small: Scene,
    vary: Mapping[str, tuple[float, float]] | None,
    options: Mapping[str, Any],
    kept: KeptSeries,
) -> Candidate:
    """A formulation with its likeliest options and hyperparameters.

    Args:
        formulation: By name or path; or an object, which is tuned on its own scene.
        scene: The scene of the fit.
        small: The same scene on the grid for tuning.
        vary: As in `ttus_opt.fitting.tuning.tune`.
        options: Options of formulations; unknown ones are ignored.
        kept: Series of other candidates.

    Raises:
        InputError: It cannot be tuned.
    """
    if isinstance(formulation, Formulation):
        return _tuned(None, formulation, formulation, kept)
    known = shelf.option_names(formulation)
    given = {k: v for k, v in options.items() if known is None or k in known}
    if vary is None:
        vary = VARIED.get(str(formulation), {})
    found: tuple[Hyperparameter, ...] = ()
    for name, (low, high) in vary.items():
        if name in options:
            continue
        median = float(np.sqrt(low * high))
        prior = Prior(f"option_{name}", median, float(np.log(high / low)) / 4.0)
        one = _chosen(_log_marginal_of(formulation, small, given, name), prior)
        given, found = given | {name: one.value}, (*found, one)

    def build(place: Scene) -> Formulation:
        return shelf.load(formulation, place, **given)

    built = build(small)
    whole = built if small is scene else build(scene)
    return replace(_tuned(build, whole, built, kept), varied=found)


def _log_marginal_of(
    formulation: str | Path, scene: Scene, given: Mapping[str, Any], name: str
) -> Callable[[float], float]:
    """Log marginal likelihood of a formulation over the value of one option."""

    def at(value: float) -> float:
        def build(place: Scene) -> Formulation:
            return shelf.load(formulation, place, **{**given, name: value})

        built = build(scene)
        return _tuned(build, built, built, KeptSeries()).log_marginal

    return at


def _tuned(
    build: Callable[[Scene], Formulation] | None,
    whole: Formulation,
    small: Formulation,
    kept: KeptSeries,
) -> Candidate:
    """The likeliest hyperparameters, over a basis that is large enough for them."""
    rows = TuningRows.of(small)
    variance, signal, n = rows.variance(), FIRST_SIGNAL, len(rows.terms)
    free_scale = build is not None and _fits_scale(whole)
    start = kept.found
    for _ in range(1 + ENLARGEMENTS):
        largest = signal / variance
        series = kept(rows, largest)
        every = np.full(n, largest)
        seen = MarginalLikelihood(thinned(series).condensed(every, MISSING))

        def slope(found: Array, seen: MarginalLikelihood = seen) -> tuple[float, Array]:
            at = Values.of(found, n, variance)
            scale = None if free_scale else 1.0
            evidence, slope = seen.with_slope(
                at.weights, at.noise, at.coefficient, scale
            )
            return evidence.log_density, Values.derivatives(slope, found)

        maximum = maximise_by_slope(slope, _priors(rows), start)
        start = kept.found = maximum.found
        values = np.array([h.value for h in maximum.found])
        if values[0] * max((1.0, *values[1:n])) < signal:
            break
        signal *= LARGER
    else:  # beyond the largest basis
        first, *others = maximum.found
        found = (replace(first, at_bound=True), *others)
        maximum = replace(maximum, found=found)
    return Candidate(build, whole, rows, variance, series, maximum, largest)


def thinned(series: MeasuredSeries) -> MeasuredSeries:
    """At most `MOST_FRAMES` evenly spaced frames."""
    return series.thinned(-(-series.frames // MOST_FRAMES))


def _fits_scale(declared: Formulation) -> bool:
    """Whether its boundary values count and their scale was fitted to the forces."""
    fitted = declared.scene_parameters.keys() - declared.scene.not_identified.keys()
    return BOUNDARY_SCALE in fitted


def _chosen(log_density: Callable[[float], float], prior: Prior) -> Hyperparameter:
    """The likeliest value of one option, by few evaluations."""
    seen: dict[float, float] = {}

    def cost(x: float) -> float:
        seen[x] = 0.5 * x**2 - log_density(prior.value(x))
        return seen[x]

    scipy.optimize.minimize_scalar(
        cost,
        bounds=(-2.5, 2.5),
        method="bounded",
        options={"xatol": OPTION_ACCURACY, "maxiter": OPTION_FITS},
    )
    x = np.array(sorted(seen))
    y = np.array([seen[at] for at in x])
    best = int(np.argmin(y))
    # a parabola through the nearest points, no flatter than the prior's
    near = slice(max(best - 2, 0), best + 3)
    curvature = 2.0 * float(np.polyfit(x[near] - x[best], y[near], 2)[0])
    spread = 1.0 / np.sqrt(max(curvature, 0.25))
    determined = bool(spread <= DETERMINED)
    value = prior.value(float(x[best])) if determined else prior.median
    own = float(spread) * prior.spread if determined else float("nan")
    return Hyperparameter(prior.name, value, prior.median, own, determined)

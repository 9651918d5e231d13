"""The likeliest hyperparameters of one formulation, by the evidence of its rows.

What is searched are the weights of its measured terms, the correlation time of what no
field can give, a coefficient of its rows such as friction, and options of the
formulation; the boundary scale follows in closed form. See docs/method.md, "Tuning".
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
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
    maximise,
)
from ttus_opt.fitting.marginal_likelihood import Evidence, MeasuredSeries
from ttus_opt.fitting.tuning_series import TuningRows
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import BOUNDARY_SCALE, Scene

#: Prior variance of a force row over that of its noise: median, and standard deviation
#: of its logarithm. Tissue differs by 40 % from its mean, which is 1 N of 3 N, and a
#: frame is known to 0.15 N [–]
SIGNAL = (64.0, 2.0)

#: What the evidence has of the first term's weight
SIGNAL_TO_NOISE = "signal_to_noise"

#: Weight of a further term over the first's: the same [–]
RATIO = (1.0, 1.5)

#: Correlation time of what a field cannot give [s]
CORRELATION_TIME = (0.15, 1.0)

#: Prior standard deviation of a coefficient such as friction, which is around 0 [–]
COEFFICIENT = 0.5

#: Largest variance of the prior over the noise's that the basis is made for at first;
#: by how much it is made larger, and how often [–]
FIRST_SIGNAL, LARGER, ENLARGEMENTS = 100.0, 30.0, 2

#: Most frames that the evidence looks at [–]
MOST_FRAMES = 200

#: Boundary scales that are used, over the scene's own; beyond, and where the standard
#: error is larger than this part of it, the scene's is kept [–]
SCALES, SCALE_ERROR = (0.5, 2.0), 0.2

#: What is tuned beside weights, by formulation and option: a range over which its
#: logarithm is about evenly likely
VARIED: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "free_surface": {"skin": (1e-6, 1e-1)}
}

#: Weights are compared up to this relative difference [–]
ROUNDING = 1e-6

#: Fits of an option's value, and to which accuracy in prior standard deviations
OPTION_FITS, OPTION_ACCURACY = 8, 0.2


class KeptSeries:
    """Series by basis, made once for formulations that measure the same field.

    The rows of eq. 10 are those with drag at a coefficient of 0.
    """

    def __init__(self) -> None:
        self._kept: list[tuple[TuningRows, float, MeasuredSeries]] = []

    def __call__(self, rows: TuningRows, weight: float) -> MeasuredSeries:
        """The series of some rows, for weights up to this."""
        for other, largest, series in self._kept:
            if weight <= largest * (1.0 + ROUNDING) and other.include(rows):
                return series if rows.coefficient else series.at(0.0)
        self._kept.append((rows, weight, rows.series(weight)))
        return self._kept[-1][2]


@dataclass(frozen=True)
class Candidate:
    """A formulation with its likeliest hyperparameters.

    Attributes:
        build: It, with the options found, over a scene; None where it is an object.
        declared: It over the scene of the fit.
        rows: It over the grid that was tuned on.
        variance: Mean prior variance of that one's first term [–].
        series: Its frames in contact, by the basis.
        maximum: Of the hyperparameters that the evidence has.
        largest: Weight that the basis holds for [–].
        varied: Options that were chosen.
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
        """What formulations are compared by [–]."""
        return self.maximum.log_marginal

    @property
    def bears_coefficient(self) -> bool:
        """Whether the data bear its coefficient, where there is one."""
        last = self.maximum.found[-1]
        return not self.rows.coefficient or (last.determined and last.value > 0.0)

    @property
    def free_scale(self) -> bool:
        """Whether the boundary scale is to be found."""
        return self.build is not None and _fits_scale(self.declared.scene)

    @property
    def values(self) -> Values:
        """The likeliest hyperparameters."""
        found = np.array([h.value for h in self.maximum.found])
        return Values.of(found, len(self.rows.terms), self.variance)

    def reaching(self, weights: Array) -> MeasuredSeries:
        """The series at its coefficient, by a basis that holds for these weights."""
        most, series = float(max(weights)), self.series
        if most > self.largest * (1.0 + ROUNDING):
            series = self.rows.series(most)
        return series.at(self.values.coefficient)

    def evidence(self) -> Evidence:
        """At the likeliest hyperparameters, with the boundary scale to use."""
        values = self.values
        series = thinned(self.series).at(values.coefficient)
        at = values.weights, values.correlation_time
        if not self.free_scale:
            return series.evidence(*at, scale=1.0)
        free = series.evidence(*at)
        bears = free.scale_error <= SCALE_ERROR * abs(free.scale)
        if bears and SCALES[0] <= free.scale <= SCALES[1]:
            return free
        return replace(series.evidence(*at, scale=1.0), scale_error=np.nan)


@dataclass(frozen=True)
class Values:
    """Hyperparameters as the evidence takes them.

    Attributes:
        weights: λ by term [–].
        correlation_time: T [s].
        coefficient: Of the rows; 0 without one.
    """

    weights: Array
    correlation_time: float
    coefficient: float

    @classmethod
    def of(cls, found: Array, n_terms: int, variance: float) -> Values:
        """From values in the order of `_priors`."""
        first = found[0] / variance
        weights = first * np.concatenate([[1.0], found[1:n_terms]])
        rest = found[n_terms + 1 :]
        return cls(weights, float(found[n_terms]), float(rest[0]) if len(rest) else 0.0)


def ratio_name(term: str, first: str) -> str:
    """Name of the hyperparameter that is a term's weight over the first's."""
    return f"{term}_over_{first}_weight"


def _priors(rows: TuningRows) -> list[Prior]:
    """In the order of `Values.of`."""
    first, *others = rows.terms
    priors = [Prior(SIGNAL_TO_NOISE, *SIGNAL)]
    priors += [Prior(ratio_name(name, first), *RATIO) for name in others]
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
    """A formulation with options and hyperparameters as likely as can be.

    Args:
        formulation: By name or path; or an object, whose scene is the small one.
        scene: Of the fit.
        small: The same on a grid to tune on.
        vary: As of `ttus_opt.fitting.tuning.tune`.
        options: Of formulations; those that it has not are left out.
        kept: Series that other candidates had made.

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
        one = _chosen(_LogMarginal(formulation, small, given, name), prior)
        given, found = given | {name: one.value}, (*found, one)

    def build(place: Scene) -> Formulation:
        return shelf.load(formulation, place, **given)

    built = build(small)
    whole = built if small is scene else build(scene)
    return replace(_tuned(build, whole, built, kept), varied=found)


@dataclass(frozen=True)
class _LogMarginal:
    """How likely a formulation is, by the value of one of its options."""

    formulation: str | Path
    scene: Scene = field(repr=False)
    given: Mapping[str, Any]
    name: str

    def __call__(self, values: Array) -> float:
        """At one value."""
        options = {**self.given, self.name: float(values[0])}

        def build(place: Scene) -> Formulation:
            return shelf.load(self.formulation, place, **options)

        built = build(self.scene)
        return _tuned(build, built, built, KeptSeries()).log_marginal


def _tuned(
    build: Callable[[Scene], Formulation] | None,
    whole: Formulation,
    small: Formulation,
    kept: KeptSeries,
) -> Candidate:
    """The likeliest hyperparameters, by a basis that is large enough for them."""
    rows = TuningRows.of(small)
    variance, signal, n = rows.variance(), FIRST_SIGNAL, len(rows.terms)
    free_scale = build is not None and _fits_scale(whole.scene)
    for _ in range(1 + ENLARGEMENTS):
        largest = signal / variance
        series = kept(rows, largest)
        seen = thinned(series)

        def log_density(found: Array, seen: MeasuredSeries = seen) -> float:
            at = Values.of(found, n, variance)
            scale = None if free_scale else 1.0
            return (
                seen.at(at.coefficient)
                .evidence(at.weights, at.correlation_time, scale)
                .log_density
            )

        maximum = maximise(log_density, _priors(rows))
        values = np.array([h.value for h in maximum.found])
        if values[0] * max((1.0, *values[1:n])) < signal:
            break
        signal *= LARGER
    else:  # beyond any basis
        first, *others = maximum.found
        found = (replace(first, at_bound=True), *others)
        maximum = replace(maximum, found=found)
    return Candidate(build, whole, rows, variance, series, maximum, largest)


def thinned(series: MeasuredSeries) -> MeasuredSeries:
    """At most `MOST_FRAMES` of its frames, evenly."""
    return series.thinned(-(-series.frames // MOST_FRAMES))


def _fits_scale(scene: Scene) -> bool:
    """Whether the scene has found its boundary scale in the forces."""
    return BOUNDARY_SCALE in scene.parameters.keys() - scene.not_identified.keys()


def _chosen(log_density: Callable[[Array], float], prior: Prior) -> Hyperparameter:
    """The likeliest value of one option, by few evaluations."""
    seen: dict[float, float] = {}

    def cost(x: float) -> float:
        seen[x] = 0.5 * x**2 - log_density(np.array([prior.value(x)]))
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
    # a parabola through the nearest points; flatter than the prior is none
    near = slice(max(best - 2, 0), best + 3)
    curvature = 2.0 * float(np.polyfit(x[near] - x[best], y[near], 2)[0])
    spread = 1.0 / np.sqrt(max(curvature, 0.25))
    bears = spread <= DETERMINED
    value = prior.value(float(x[best])) if bears else prior.median
    told = float(spread) * prior.spread if bears else float("nan")
    return Hyperparameter(prior.name, value, prior.median, told, bears)

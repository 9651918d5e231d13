"""Weights, boundary scale, friction and options by marginal likelihood, without a grid.

The evidence of a formulation (`marginal_likelihood`) is a closed form of a reduced
basis, so that a search over all its hyperparameters at once takes a second. Beside it,
for comparison, stand presses left out in turn and generalised cross-validation
(`weight_criteria`). See docs/method.md, "Tuning".
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import scipy.optimize

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.fitting.hyperparameters import (
    DETERMINED,
    Hyperparameter,
    Maximum,
    Prior,
    maximise,
)
from ttus_opt.fitting.marginal_likelihood import Evidence, MeasuredSeries
from ttus_opt.fitting.tuning_series import TuningRows, coarser
from ttus_opt.fitting.weight_criteria import Criteria
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import BOUNDARY_SCALE, Scene

#: Prior variance of a force row over that of its noise: median, and standard deviation
#: of its logarithm. Tissue differs by 40 % from its mean, which is 1 N of 3 N, and a
#: frame is known to 0.15 N [–]
SIGNAL = (64.0, 2.0)

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

#: Fits of an option's value, and to which accuracy in prior standard deviations
OPTION_FITS, OPTION_ACCURACY = 8, 0.2

#: Factors on the weights, for comparison with other criteria [–]
FACTORS = np.geomspace(1e-3, 1e3, 13)


@dataclass(frozen=True)
class Comparison:
    """What another criterion would have chosen.

    Attributes:
        criterion: ``left_out_force_error`` or ``gcv``.
        weights: λ by term: the tuned ones times a common factor [–].
        left_out_force_error: Mean error of forces on presses left out with them [N].
    """

    criterion: str
    weights: Mapping[str, float]
    left_out_force_error: float


@dataclass(frozen=True)
class Tuning:
    """What was found; ``fit(tuning.scene, tuning.formulation)`` uses it.

    Attributes:
        formulation: With weights and options as found.
        scene: With the boundary scale as found.
        hyperparameters: All that was looked for.
        weights: λ by term, for a fit of independent frames [–].
        noise: Standard deviation of a force component's error [N].
        variance: σ², of a row of weight 1 where frames are independent [N²].
        log_marginal: What formulations are compared by [–].
        left_out_force_error: Mean error on presses left out in turn, NaN with one
            press [N].
        comparisons: What other criteria would have chosen.
        candidates: ``log_marginal`` of all formulations that were tried, by name [–].
        shape: Voxels of the grid it was tuned on.
        seconds: It took [s].
    """

    formulation: Formulation
    scene: Scene = field(repr=False)
    hyperparameters: tuple[Hyperparameter, ...]
    weights: Mapping[str, float]
    noise: float
    variance: float
    log_marginal: float
    left_out_force_error: float
    comparisons: tuple[Comparison, ...]
    candidates: Mapping[str, float]
    shape: tuple[int, ...]
    seconds: float = field(compare=False)

    @property
    def not_determined(self) -> tuple[str, ...]:
        """Hyperparameters that the data do not bear, which have their prior value."""
        return tuple(h.name for h in self.hyperparameters if not h.determined)


def tune(
    scene: Scene,
    formulations: str | Path | Formulation | Sequence[str | Path] = (
        "eq10",
        "coulomb_global",
    ),
    *,
    vary: Mapping[str, tuple[float, float]] | None = None,
    compare: bool = True,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Tuning:
    """Choose weights, boundary scale, friction and options by marginal likelihood.

    Limits of a formulation, such as p ≥ 0, are left out: the evidence is that of the
    Gaussian without them. A grid of more than 60,000 voxels is tuned on a coarser one;
    a Formulation that is an object, on its own.

    Args:
        scene: With measured wrenches.
        formulations: One, or several of which the most likely is taken.
        vary: Options to choose, with the range over which they may lie; None for
            those of `VARIED`. Several are chosen one after the other.
        compare: Whether to look at other criteria, too.
        progress: Called with what begins, once per formulation.
        options: Of the formulations, by name; each gets those that it has.

    Raises:
        InputError: No contact, no measured force, or a formulation whose prior is not
            Laplace's.
    """
    begin = progress or (lambda _: None)
    start = time.perf_counter()
    if isinstance(formulations, str | Path | Formulation):
        formulations = [formulations]  # type: ignore[list-item]
    if not scene.trajectory.has_wrench or not (scene.rows.contact_points > 0).any():
        raise InputError(
            "tuning needs forces measured in contact: check the recordings' frame and "
            "unit, or give weights"
        )
    small = coarser(scene)
    tried = []
    for one in formulations:
        begin(f"tuning {one.name if isinstance(one, Formulation) else one}")
        tried.append(_candidate(one, scene, small, vary, options))
    best = max(tried, key=lambda candidate: candidate.log_marginal)
    found = _finished(best, compare)
    return replace(
        found,
        candidates={one.declared.name: one.log_marginal for one in tried},
        seconds=time.perf_counter() - start,
    )


@dataclass(frozen=True)
class _Candidate:
    """A formulation with its likeliest hyperparameters.

    Attributes:
        build: It, with the options found, over a scene; None where it is an object.
        declared: It over the scene of the fit.
        rows: It over the grid that was tuned on.
        variance: Mean prior variance of that one's first term [–].
        series: Its frames in contact, by the basis.
        maximum: Of the hyperparameters that the evidence has.
        varied: Options that were chosen.
    """

    build: Callable[[Scene], Formulation] | None
    declared: Formulation
    rows: TuningRows
    variance: float
    series: MeasuredSeries
    maximum: Maximum
    varied: tuple[Hyperparameter, ...] = ()

    @property
    def log_marginal(self) -> float:
        """What formulations are compared by [–]."""
        return self.maximum.log_marginal

    @property
    def free_scale(self) -> bool:
        """Whether the boundary scale is to be found."""
        return self.build is not None and _fits_scale(self.declared.scene)

    @property
    def values(self) -> _Values:
        """The likeliest hyperparameters."""
        found = np.array([h.value for h in self.maximum.found])
        return _Values.of(found, len(self.rows.terms), self.variance)

    def evidence(self) -> Evidence:
        """At the likeliest hyperparameters, with the boundary scale to use."""
        values = self.values
        series = _thinned(self.series).at(values.coefficient)
        at = values.weights, values.correlation_time
        if not self.free_scale:
            return series.evidence(*at, scale=1.0)
        free = series.evidence(*at)
        bears = free.scale_error <= SCALE_ERROR * abs(free.scale)
        if bears and SCALES[0] <= free.scale <= SCALES[1]:
            return free
        return replace(series.evidence(*at, scale=1.0), scale_error=np.nan)


@dataclass(frozen=True)
class _Values:
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
    def of(cls, found: Array, n_terms: int, variance: float) -> _Values:
        """From values in the order of `_priors`."""
        first = found[0] / variance
        weights = first * np.concatenate([[1.0], found[1:n_terms]])
        rest = found[n_terms + 1 :]
        return cls(weights, float(found[n_terms]), float(rest[0]) if len(rest) else 0.0)


def _priors(rows: TuningRows) -> list[Prior]:
    """In the order of `_Values.of`."""
    first, *others = rows.terms
    priors = [Prior("signal_to_noise", *SIGNAL)]
    priors += [Prior(f"{name}_over_{first}_weight", *RATIO) for name in others]
    priors.append(Prior("correlation_time", *CORRELATION_TIME, unit="s"))
    if rows.coefficient:
        priors.append(
            Prior(rows.coefficient, 0.0, COEFFICIENT, linear=True, highest=rows.highest)
        )
    return priors


def _candidate(
    formulation: str | Path | Formulation,
    scene: Scene,
    small: Scene,
    vary: Mapping[str, tuple[float, float]] | None,
    options: Mapping[str, Any],
) -> _Candidate:
    """A formulation with options and hyperparameters as likely as can be."""
    if isinstance(formulation, Formulation):
        return _tuned(None, formulation, formulation)
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
    return replace(_tuned(build, whole, built), varied=found)


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
        return _tuned(build, built, built).log_marginal


def _tuned(
    build: Callable[[Scene], Formulation] | None,
    whole: Formulation,
    small: Formulation,
) -> _Candidate:
    """The likeliest hyperparameters, by a basis that is large enough for them."""
    rows = TuningRows.of(small)
    variance, signal, n = rows.variance(), FIRST_SIGNAL, len(rows.terms)
    free_scale = build is not None and _fits_scale(whole.scene)
    for _ in range(1 + ENLARGEMENTS):
        series = rows.series(signal / variance)
        seen = _thinned(series)

        def log_density(found: Array, seen: MeasuredSeries = seen) -> float:
            at = _Values.of(found, n, variance)
            scale = None if free_scale else 1.0
            return (
                seen.at(at.coefficient)
                .evidence(at.weights, at.correlation_time, scale)
                .log_density
            )

        maximum = maximise(log_density, _priors(rows))
        values = np.array([h.value for h in maximum.found])
        if values[0] * max(1.0, *values[1:n]) < signal:
            break
        signal *= LARGER
    return _Candidate(build, whole, rows, variance, series, maximum)


def _thinned(series: MeasuredSeries) -> MeasuredSeries:
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


def _finished(best: _Candidate, compare: bool) -> Tuning:
    """What is told of the likeliest formulation."""
    rows, values, evidence = best.rows, best.values, best.evidence()
    series = best.series.at(values.coefficient)
    at = values.weights, values.correlation_time
    independent = values.weights * series.independent_share(*at)
    whole = TuningRows.of(best.declared)
    # the same prior variance at the contacts, on the grid of the fit
    same = best.declared.scene is rows.declared.scene
    grid = 1.0 if same else best.variance / whole.variance()
    final = dict(zip(rows.terms, map(float, grid * independent), strict=True))
    scene, scale = _scaled(best, evidence)
    declared = best.declared if best.build is None else best.build(scene)
    judge = _Judge(series, evidence.scale)
    force = rows.terms.index("force") if "force" in rows.terms else 0
    return Tuning(
        declared.with_weights(**final),
        scene,
        (*best.maximum.found, *scale, *best.varied),
        final,
        float(np.sqrt(evidence.variance / values.weights[force])),
        evidence.variance * grid,
        best.log_marginal,
        judge(independent)["left_out_force_error"],
        judge.others(independent, grid) if compare else (),
        {},
        tuple(map(int, rows.declared.scene.voxmap.grid.shape)),
        0.0,
    )


def _scaled(
    best: _Candidate, evidence: Evidence
) -> tuple[Scene, tuple[Hyperparameter, ...]]:
    """The scene with the boundary scale found, and how well it is known."""
    scene = best.declared.scene
    if not best.free_scale:
        return scene, ()
    bears = np.isfinite(evidence.scale_error)
    inner = evidence.scale * scene.inner
    error = evidence.scale_error * scene.inner
    told = Hyperparameter(BOUNDARY_SCALE, inner, scene.inner, float(error), bool(bears))
    if not bears:
        return scene, (told,)
    scaled = replace(
        scene.with_boundary(inner, evidence.scale * scene.outer),
        parameters={**scene.parameters, BOUNDARY_SCALE: inner},
        standard_errors={**scene.standard_errors, BOUNDARY_SCALE: float(error)},
        not_identified=scene.not_identified,
    )
    return scaled, (told,)


@dataclass(frozen=True)
class _Judge:
    """Criteria beside the evidence, for independent frames.

    Attributes:
        series: All frames in contact.
        scale: Of the boundary values.
    """

    series: MeasuredSeries = field(repr=False)
    scale: float

    def __call__(self, weights: Array) -> dict[str, float]:
        """All criteria for weights by term."""
        series = self.series
        k, n = len(series.images), 3 * series.frames
        force = series.terms.index("force") if "force" in series.terms else 0
        criteria = Criteria(
            np.tile(np.repeat(series.press, 3), len(series.terms)),
            np.arange(force * n, (force + 1) * n),
            series.target[force].reshape(-1),
        )
        misfit = (series.target - self.scale * series.base).reshape(-1)
        root = np.repeat(np.sqrt(weights), n)
        return criteria.values(series.images.reshape(k, -1), misfit, root)

    def others(self, weights: Array, grid: float) -> tuple[Comparison, ...]:
        """What the others choose, among multiples of the weights."""
        told = [self(factor * weights) for factor in FACTORS]
        found = []
        for name in ("left_out_force_error", "gcv"):
            scores = np.array([one[name] for one in told])
            if np.isnan(scores).all():
                continue
            at = int(np.nanargmin(scores))
            final = map(float, grid * FACTORS[at] * weights)
            chosen = dict(zip(self.series.terms, final, strict=True))
            found.append(Comparison(name, chosen, told[at]["left_out_force_error"]))
        return tuple(found)

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

from ttus_opt.arrays import Array, IntArray
from ttus_opt.errors import InputError
from ttus_opt.fitting.hyperparameters import Hyperparameter
from ttus_opt.fitting.left_out import LeftOut
from ttus_opt.fitting.marginal_likelihood import Evidence, MeasuredSeries
from ttus_opt.fitting.tuning_candidate import (
    SIGNAL_TO_NOISE,
    Candidate,
    KeptSeries,
    candidate,
    ratio_name,
)
from ttus_opt.fitting.tuning_series import TuningRows, coarser
from ttus_opt.fitting.weight_criteria import Criteria
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import BOUNDARY_SCALE, Scene

#: What is compared by default: drag first, whose rows include those without
CANDIDATES = ("coulomb_global", "eq10")

#: Factors on the weights, for comparison with other criteria [–]
FACTORS = np.geomspace(1e-3, 1e3, 13)


#: Voxels of a grid that is looked at before tuning, and ratios of the prior's variance
#: to the noise's there [–]
LOOK_VOXELS, LOOK_SIGNALS = 4_000, np.geomspace(1e-2, 1e2, 9)


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
        left_out: Errors on presses left out in turn.
        own_left_out: The same with the formulation's own weights and boundary scale.
        simpler: Likeliest of the formulations named after this one, if there is any.
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
    left_out: LeftOut = field(compare=False, repr=False)
    own_left_out: LeftOut = field(compare=False, repr=False)
    simpler: Tuning | None = field(default=None, compare=False, repr=False)

    @property
    def not_determined(self) -> tuple[str, ...]:
        """Hyperparameters that the data do not bear, which have their prior value."""
        return tuple(h.name for h in self.hyperparameters if not h.determined)

    @property
    def weight_factors(self) -> Mapping[str, float]:
        """Exponential of the standard deviation of the logarithm of λ, by term [–]."""
        spread = {h.name: h.spread for h in self.hyperparameters if h.determined}
        own = spread.get(SIGNAL_TO_NOISE, np.nan)
        first = next(iter(self.weights), "")
        return {
            name: float(np.exp(np.hypot(own, spread.get(ratio_name(name, first), 0.0))))
            for name in self.weights
        }


def tune(
    scene: Scene,
    formulations: str
    | Path
    | Formulation
    | Sequence[str | Path | Formulation] = CANDIDATES,
    *,
    vary: Mapping[str, tuple[float, float]] | None = None,
    compare: bool = True,
    progress: Callable[[str], None] | None = None,
    **options: Any,
) -> Tuning:
    """Choose weights, boundary scale, friction and options by marginal likelihood.

    Limits of a formulation, such as p ≥ 0, are left out: the evidence is that of the
    Gaussian without them. A grid of more than 16,000 voxels is tuned on a coarser one;
    a Formulation that is an object, on its own.

    Args:
        scene: With measured wrenches.
        formulations: One, or several, richer ones first, of which the most likely is
            taken; none with a coefficient that the data do not bear where there is
            another.
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
        formulations = [formulations]
    if not scene.trajectory.has_wrench or not (scene.rows.contact_points > 0).any():
        raise InputError(
            "tuning needs forces measured in contact: check the recordings' frame and "
            "unit, or give weights"
        )
    small, kept = coarser(scene), KeptSeries()
    tried = []
    for one in formulations:
        begin(f"tuning {one.name if isinstance(one, Formulation) else one}")
        tried.append(candidate(one, scene, small, vary, options, kept))
    found = _finished(tried, compare)
    return replace(found, seconds=time.perf_counter() - start)


def _finished(tried: Sequence[Candidate], compare: bool) -> Tuning:
    """What is told of the likeliest formulation."""
    borne = [each for each in tried if each.bears_coefficient] or tried
    best = max(borne, key=lambda each: each.log_marginal)
    after = tried[[one is best for one in tried].index(True) + 1 :]
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
    name, frames = declared.name, rows.declared.scene.rows.contact_points
    judge = _Judge(series, evidence.scale, np.flatnonzero(frames > 0))
    own = {t.name: t.weight for t in best.declared.terms if t.measures}
    own_weights = np.array([own[term] for term in rows.terms]) / grid
    known = replace(judge, series=best.reaching(own_weights), scale=1.0)
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
        {one.declared.name: one.log_marginal for one in tried},
        tuple(map(int, rows.declared.scene.voxmap.grid.shape)),
        0.0,
        judge.left_out(f"{name} with the weights chosen", independent),
        known.left_out(f"{name} with its own weights", own_weights),
        _finished(after, False) if after else None,
    )


def _scaled(
    best: Candidate, evidence: Evidence
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


def best_left_out(scene: Scene, name: str, options: Mapping[str, Any]) -> LeftOut:
    """Presses left out of a formulation with whatever weights serve it best there.

    On a coarse grid, all terms with one of `LOOK_SIGNALS`: a tenth of what `tune`
    takes, and hardly worse for a formulation than its likeliest weights.

    Args:
        scene: With measured wrenches.
        name: Of a formulation without a coefficient in its rows.
        options: Of formulations; those that it has not are left out.

    Raises:
        InputError: It cannot be tuned.
    """
    small = coarser(scene, LOOK_VOXELS)
    known = shelf.option_names(name)
    own = {k: v for k, v in options.items() if known is None or k in known}
    rows = TuningRows.of(shelf.load(name, small, **own))
    weights = LOOK_SIGNALS / rows.variance()
    touching = np.flatnonzero(small.rows.contact_points > 0)
    judge = _Judge(rows.series(float(weights.max())), 1.0, touching)
    ones, words = np.ones(len(rows.terms)), f"{name} with its best weights"
    found = [judge.left_out(words, weight * ones) for weight in weights]
    return min(found, key=lambda one: one.mean_over(judge.series.press))


@dataclass(frozen=True)
class _Judge:
    """Criteria beside the evidence, for independent frames.

    Attributes:
        series: All frames in contact.
        scale: Of the boundary values.
        frames: Which ones these are of the trajectory, shape (frames,) [–].
    """

    series: MeasuredSeries = field(repr=False)
    scale: float
    frames: IntArray = field(repr=False)

    def __call__(self, weights: Array) -> dict[str, float]:
        """All criteria for weights by term."""
        criteria, at = self._criteria, self._at(weights)
        return criteria.values(*at)

    def left_out(self, model: str, weights: Array) -> LeftOut:
        """Errors on presses left out in turn, of a model in words."""
        predicted = self._criteria.left_out(*self._at(weights))
        error = self._criteria.force.reshape(-1, 3) - predicted
        return LeftOut(model, self.frames, np.linalg.norm(error, axis=1))

    @property
    def _criteria(self) -> Criteria:
        series, n = self.series, 3 * self.series.frames
        force = series.terms.index("force") if "force" in series.terms else 0
        return Criteria(
            np.tile(np.repeat(series.press, 3), len(series.terms)),
            np.arange(force * n, (force + 1) * n),
            series.target[force].reshape(-1),
        )

    def _at(self, weights: Array) -> tuple[Array, Array, Array]:
        """Images, misfit and roots of the weights, as `Criteria` takes them."""
        series = self.series
        misfit = (series.target - self.scale * series.base).reshape(-1)
        root = np.repeat(np.sqrt(weights), 3 * series.frames)
        return series.images.reshape(len(series.images), -1), misfit, root

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

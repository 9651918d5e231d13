"""Weights, boundary scale, friction and options by marginal likelihood, without a grid.

The evidence of a formulation (`marginal_likelihood`) has a closed form over a reduced
basis, so that a search over all hyperparameters at once takes a second. Presses left
out in turn and generalised cross-validation (`weight_criteria`) are given for
comparison. See docs/method.md, "Tuning".
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.arrays import Array, IntArray
from ttus_opt.blas_threads import one_blas_thread
from ttus_opt.errors import InputError
from ttus_opt.fitting.hyperparameters import Hyperparameter
from ttus_opt.fitting.left_out import LeftOut
from ttus_opt.fitting.marginal_likelihood import Evidence, MeasuredSeries
from ttus_opt.fitting.one_sense import warn_of_one_sense
from ttus_opt.fitting.place_left_out import PlaceLeftOut
from ttus_opt.fitting.tuning_candidate import (
    MISSING,
    SIGNAL_TO_NOISE,
    Candidate,
    KeptSeries,
    candidate,
    ratio_name,
)
from ttus_opt.fitting.tuning_series import TuningRows, coarser
from ttus_opt.fitting.weight_criteria import Criteria
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import BOUNDARY_SCALE, Scene

#: Formulations compared by default: drag first, whose rows include those without it
CANDIDATES = ("coulomb_global", "eq10")

#: Factors on the weights, for comparison with other criteria [–]
FACTORS = np.geomspace(1e-3, 1e3, 13)


@dataclass(frozen=True)
class Comparison:
    """The choice by another criterion.

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
    """Result of `tune`; ``fit(tuning.scene, tuning.formulation)`` uses it.

    Attributes:
        formulation: With the chosen weights and options.
        scene: With the chosen boundary scale.
        hyperparameters: All estimated hyperparameters.
        weights: λ by term, for a fit that assumes independent frames [–].
        noise: Standard deviation of a force component's error [N].
        variance: σ², variance of a row of weight 1, for independent frames [N²].
        log_marginal: The figure by which formulations are compared [–].
        left_out_force_error: Mean error on presses left out in turn; NaN with one
            press [N].
        comparisons: The choices by other criteria.
        candidates: ``log_marginal`` of all candidates, by name [–].
        shape: Shape of the grid for tuning.
        seconds: Time spent [s].
        left_out: Errors on presses left out in turn.
        own_left_out: The same with the formulation's own weights and boundary scale.
        simpler: The likeliest of the candidates after this one, if there is one.
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
        """Hyperparameters that the data do not determine, at their prior values."""
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


@one_blas_thread()
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

    Limits such as p ≥ 0 are left out: the evidence is that of the Gaussian without
    them. A grid of more than 60,000 voxels is replaced by a coarser one for tuning,
    except for a Formulation object.

    Args:
        scene: With measured wrenches.
        formulations: One, or several, richer ones first; the likeliest is taken, but
            one with an undetermined coefficient only where there is no other.
        vary: Ranges of options to choose, one after the other; `VARIED` by default.
        compare: Whether to evaluate the other criteria too.
        progress: Called with a message for every formulation.
        options: Options of the formulations; each gets those that it has.

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
    if len(tried) > 1:
        for each in tried:
            warn_of_one_sense(each.declared, "it is left out")
    found = _finished(tried, compare)
    return replace(found, seconds=time.perf_counter() - start)


def _finished(tried: Sequence[Candidate], compare: bool) -> Tuning:
    """The result for the likeliest candidate."""
    determined = [each for each in tried if each.bears_coefficient] or tried
    best = max(determined, key=lambda each: each.log_marginal)
    after = tried[[one is best for one in tried].index(True) + 1 :]
    rows, values, evidence = best.rows, best.values, best.evidence()
    series = best.series.at(values.coefficient)
    few = series.condensed(values.weights, MISSING)
    left_out = PlaceLeftOut.of(few, values.weights, values.noise)
    independent = values.weights * left_out.shares()
    grid = 1.0
    if best.declared.scene is not rows.declared.scene:
        # rescale the weights to the prior variance on the grid of the fit
        grid = best.variance / TuningRows.of(best.declared).variance()
    final = dict(zip(rows.terms, map(float, grid * independent), strict=True))
    scene, scale = _scaled(best, evidence)
    declared = best.declared if best.build is None else best.build(scene)
    name, frames = declared.name, rows.declared.scene.rows.contact_points
    judge = _Judge(series, evidence.scale, np.flatnonzero(frames > 0))
    predicted = judge.predicted(independent)
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
        judge.magnitude_error(predicted),
        judge.others(independent, grid) if compare else (),
        {one.declared.name: one.log_marginal for one in tried},
        tuple(map(int, rows.declared.scene.voxmap.grid.shape)),
        0.0,
        judge.left_out(f"{name} with the weights chosen", predicted),
        known.left_out(f"{name} with its own weights", known.predicted(own_weights)),
        _finished(after, False) if after else None,
    )


def _scaled(
    best: Candidate, evidence: Evidence
) -> tuple[Scene, tuple[Hyperparameter, ...]]:
    """The scene with its estimated boundary scale, and that hyperparameter."""
    scene = best.declared.scene
    if not best.free_scale:
        return scene, ()
    determined = bool(np.isfinite(evidence.scale_error))
    inner = evidence.scale * scene.inner
    error = float(evidence.scale_error * scene.inner)
    found = Hyperparameter(BOUNDARY_SCALE, inner, scene.inner, error, determined)
    if not determined:
        return scene, (found,)
    scaled = replace(
        scene.with_boundary(inner, evidence.scale * scene.outer),
        parameters={**scene.parameters, BOUNDARY_SCALE: inner},
        standard_errors={**scene.standard_errors, BOUNDARY_SCALE: error},
        not_identified=scene.not_identified,
    )
    return scaled, (found,)


@dataclass(frozen=True)
class _Judge:
    """Criteria other than the evidence, for independent frames.

    Attributes:
        series: All frames in contact.
        scale: Factor on the boundary values.
        frames: Their numbers in the trajectory, shape (frames,) [–].
    """

    series: MeasuredSeries = field(repr=False)
    scale: float
    frames: IntArray = field(repr=False)

    def __call__(self, weights: Array) -> dict[str, float]:
        """All criteria for weights by term."""
        return self._criteria.values(*self._at(weights))

    def predicted(self, weights: Array) -> Array:
        """Forces that all other presses predict, shape (n, 3) [N]."""
        return self._criteria.left_out(*self._at(weights))

    def left_out(self, model: str, predicted: Array) -> LeftOut:
        """The errors of these; ``model`` is the name of what predicted them."""
        error = self._force - predicted
        return LeftOut(model, self.frames, np.linalg.norm(error, axis=1))

    def magnitude_error(self, predicted: Array) -> float:
        """Mean error of their magnitudes; NaN with one press [N]."""
        if len(np.unique(self.series.press)) < 2:
            return np.nan
        sizes = (np.linalg.norm(v, axis=1) for v in (self._force, predicted))
        return float(np.abs(np.subtract(*sizes)).mean())

    @property
    def _force(self) -> Array:
        """Measured forces, shape (n, 3) [N]."""
        return self._criteria.force.reshape(-1, 3)

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
        """The choices by other criteria, among multiples of the weights."""
        criteria = [self(factor * weights) for factor in FACTORS]
        found = []
        for name in ("left_out_force_error", "gcv"):
            scores = np.array([one[name] for one in criteria])
            if np.isnan(scores).all():
                continue
            at = int(np.nanargmin(scores))
            final = map(float, grid * FACTORS[at] * weights)
            chosen = dict(zip(self.series.terms, final, strict=True))
            error = criteria[at]["left_out_force_error"]
            found.append(Comparison(name, chosen, error))
        return tuple(found)

"""Weights, boundary scale and friction by how places left out are predicted.

Over a reduced basis the prediction of one place from all others has a closed form
(`place_left_out`), so that the search takes a second. The evidence of independent
frames and generalised cross-validation are given for comparison: errors persist along a
press, and both take weights that are too large. See docs/method/identification.md,
"Tuning".
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.contact.scene import BOUNDARY_SCALE, Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.fitting.parameters.identification import warn_of_untold_friction
from ttus_opt.fitting.weights.coarse_scene import coarser
from ttus_opt.fitting.weights.place_left_out import (
    COEFFICIENT,
    FARTHEST,
    RATIO,
    SIGNAL,
    PlaceLeftOut,
    Prediction,
    criteria,
)
from ttus_opt.fitting.weights.tuning_result import (
    SIGNAL_TO_NOISE,
    Check,
    Comparison,
    Hyperparameter,
    Tuning,
    ratio_name,
)
from ttus_opt.fitting.weights.tuning_rows import TuningRows
from ttus_opt.problem.formulation import Formulation, load, option_defaults

#: Formulations compared by default: drag first, whose rows include those without it
CANDIDATES = ("coulomb_global", "eq10")

#: Options tuned beside the weights, by formulation, with a range over which their
#: logarithm is about uniform; values of it that are tried
VARIED: Mapping[str, Mapping[str, tuple[float, float]]] = {
    "free_surface": {"skin": (1e-6, 1e-1)}
}
TRIED = 6

#: Largest signal to noise of the first basis; factor for a second one, and the share
#: of it from which the second is made [–]
FIRST_SIGNAL, LARGER, NEARLY = 30.0, 300.0, 0.5

#: Factors on the weights, for comparison with other criteria [–]
FACTORS = np.geomspace(1e-3, 1e3, 13)

#: Largest posterior standard deviation of a determined hyperparameter, over its prior's
#: [–]
DETERMINED = 0.7


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
    """Choose weights, boundary scale, friction and options by places left out.

    Any formulation of squares can be tuned: the weights are those of its terms that
    measure. Limits such as p ≥ 0 are left out. A grid of more than 60,000 voxels is
    replaced by a coarser one for tuning, except for a Formulation object and for a
    prior that is not Laplace's.

    Args:
        scene: With measured wrenches.
        formulations: One, or several; the one that predicts best is taken, but one with
            an undetermined coefficient only where there is no other.
        vary: Ranges of options to choose, one after the other; `VARIED` by default.
        compare: Whether to evaluate the other criteria too.
        progress: Called with a message for every formulation.
        options: Options of the formulations; each gets those that it has.

    Raises:
        InputError: No contact, no measured force, or a formulation that is no sum of
            squares.
    """
    begin = progress or (lambda _: None)
    start = time.perf_counter()
    if isinstance(formulations, str | Path | Formulation):
        formulations = [formulations]
    if not scene.trajectory.has_wrench or not scene.touching.any():
        raise InputError(
            "tuning needs forces measured in contact: check the recordings' frame and "
            "unit, or give weights"
        )
    tried = []
    for one in formulations:
        begin(f"tuning {one.name if isinstance(one, Formulation) else one}")
        tried.append(_candidate(one, scene, vary, options))
    if len(tried) > 1:
        for each in tried:
            warn_of_untold_friction(each.declared, "it is left out")
    known = [each for each in tried if each.bears_coefficient] or tried
    best = max(known, key=lambda each: each.log_density)
    errors = {each.declared.name: each.force_error for each in tried}
    tuning = best.tuning(compare)
    return replace(tuning, candidates=errors, seconds=time.perf_counter() - start)


@dataclass(frozen=True)
class _Candidate:
    """A formulation with its most likely hyperparameters.

    Attributes:
        build: Builds it over a scene, with the chosen options; None for an object.
        declared: The formulation over the scene of the fit.
        rows: Its rows on the grid for tuning.
        judge: These over a basis.
        steps: Most likely steps from the priors' medians, shape (n,) [–].
        spread: Their posterior standard deviations, shape (n,) [–].
        own: Its own weights on the grid for tuning, shape (terms,) [–].
        grid: Factor from weights on the grid for tuning to those of the fit [–].
        varied: The chosen options.
    """

    build: Callable[[Scene], Formulation] | None
    declared: Formulation
    rows: TuningRows
    judge: PlaceLeftOut
    steps: Array
    spread: Array
    own: Array
    grid: float
    varied: tuple[Hyperparameter, ...] = ()

    @property
    def log_density(self) -> float:
        """The figure by which formulations are compared [–]."""
        prior = 0.5 * float(self.steps @ self.steps)
        return self.judge.log_density(*self.judge.values(self.steps)) - prior

    @property
    def bears_coefficient(self) -> bool:
        """Whether the data determine its coefficient, if it has one."""
        if not self.rows.coefficient:
            return not self.declared.not_identifiable()
        coefficient = self.hyperparameters[-1]
        return coefficient.determined and coefficient.value > 0.0

    @property
    def prediction(self) -> Prediction:
        """What it predicts at places left out."""
        return self.judge.predicted(*self.judge.values(self.steps))

    @property
    def force_error(self) -> float:
        """Mean error of forces at places left out [N]."""
        return float(self._by_place(self.prediction).mean())

    @property
    def hyperparameters(self) -> tuple[Hyperparameter, ...]:
        """Those of weights and the coefficient."""
        weights, coefficient = self.judge.values(self.steps)
        first, *others = self.rows.terms
        medians = {SIGNAL_TO_NOISE: SIGNAL} | {
            ratio_name(n, first): RATIO for n in others
        }
        signal = float(weights[0]) * self.judge.variance
        values = [signal, *(float(w / weights[0]) for w in weights[1:])]
        listed = [
            Hyperparameter(
                name,
                value,
                median,
                float(spread * width),
                bool(spread <= DETERMINED),
                bool(abs(step) >= FARTHEST)
                or (name == SIGNAL_TO_NOISE and value >= self.judge.largest),
            )
            for (name, (median, width)), value, step, spread in zip(
                medians.items(), values, self.steps, self.spread, strict=False
            )
        ]
        if self.rows.coefficient:
            told = bool(self.spread[-1] <= DETERMINED)
            error = float(COEFFICIENT * self.spread[-1])
            name, bound = self.rows.coefficient, coefficient >= self.rows.highest
            listed.append(Hyperparameter(name, coefficient, 0.0, error, told, bound))
        return tuple(listed)

    def tuning(self, compare: bool) -> Tuning:
        """The result, alone."""
        weights, coefficient = self.judge.values(self.steps)
        prediction = self.prediction
        scene, scale = self._scaled(prediction)
        declared = self.declared if self.build is None else self.build(scene)
        final = dict(zip(self.rows.terms, map(float, self.grid * weights), strict=True))
        chosen = self._by_place(prediction)
        usual = self._by_place(self.judge.predicted(self.own, coefficient))
        spread = np.nan
        if len(chosen) > 1:
            spread = float((chosen - usual).std(ddof=1) / np.sqrt(len(chosen)))
        means = float(chosen.mean()), float(usual.mean())
        first = prediction.errors[self.judge.rows.term == 0]
        return Tuning(
            declared.with_weights(**final),
            scene,
            (*self.hyperparameters, *scale, *self.varied),
            final,
            float(np.sqrt(np.mean(first**2))),
            Check(declared.name, len(chosen), *means, spread),
            self._others(weights, coefficient) if compare else (),
            {},
            tuple(map(int, self.rows.declared.scene.voxmap.grid.shape)),
            0.0,
        )

    def _by_place(self, prediction: Prediction) -> Array:
        """Mean length of the error by place, of forces or else the first term."""
        names, rows = self.rows.terms, self.judge.rows
        at = rows.term == (names.index("force") if "force" in names else 0)
        errors, place = prediction.errors[at], rows.place[at]
        if "force" in names and len(errors) % 3 == 0:
            errors = np.linalg.norm(errors.reshape(-1, 3), axis=1)
            place = place[::3]
        _, number, count = np.unique(place, return_inverse=True, return_counts=True)
        return np.asarray(np.bincount(number, abs(errors)) / count)

    def _scaled(
        self, prediction: Prediction
    ) -> tuple[Scene, tuple[Hyperparameter, ...]]:
        """The scene with its estimated boundary scale, and that hyperparameter."""
        scene = self.declared.scene
        if not self.judge.free_scale:
            return scene, ()
        error = float(prediction.scale_error * scene.inner)
        inner = prediction.scale * scene.inner
        told = bool(np.isfinite(error))
        parameter = Hyperparameter(BOUNDARY_SCALE, inner, scene.inner, error, told)
        if not told:
            return scene, (parameter,)
        scaled = replace(
            scene.with_boundary(inner, prediction.scale * scene.outer),
            parameters={**scene.parameters, BOUNDARY_SCALE: inner},
            standard_errors={**scene.standard_errors, BOUNDARY_SCALE: error},
            not_identified=scene.not_identified,
        )
        return scaled, (parameter,)

    def _others(self, weights: Array, coefficient: float) -> tuple[Comparison, ...]:
        """The choices by other criteria, among multiples of the weights."""
        rows = self.judge.rows.at(coefficient)
        rows = replace(rows, base=self.prediction.scale * rows.base)
        every = weights[rows.term] * rows.every
        scores = [criteria(rows, np.sqrt(factor * every)) for factor in FACTORS]
        comparisons = []
        for name, sign in (("log_evidence", -1.0), ("gcv", 1.0)):
            best = FACTORS[int(np.argmin([sign * one[name] for one in scores]))]
            final = map(float, self.grid * best * weights)
            error = self._by_place(self.judge.predicted(best * weights, coefficient))
            chosen = dict(zip(self.rows.terms, final, strict=True))
            comparisons.append(Comparison(name, chosen, float(error.mean())))
        return tuple(comparisons)


def _candidate(
    formulation: str | Path | Formulation,
    scene: Scene,
    vary: Mapping[str, tuple[float, float]] | None,
    options: Mapping[str, Any],
) -> _Candidate:
    """A formulation with its most likely options and hyperparameters.

    Raises:
        InputError: It cannot be tuned.
    """
    if isinstance(formulation, Formulation):
        load(formulation, scene, **options)  # it takes none
        return _tuned(None, formulation, formulation)
    known = option_defaults(formulation)
    given = {k: v for k, v in options.items() if known is None or k in known}
    if vary is None:
        vary = VARIED.get(str(formulation), {})

    def tuned(given: Mapping[str, Any], alone: bool) -> _Candidate:
        def build(place: Scene) -> Formulation:
            return load(formulation, place, **given)

        whole = build(scene)
        small = build(coarser(scene)) if TuningRows.of(whole).is_laplace else whole
        return _tuned(build, small if alone else whole, small)

    varied: tuple[Hyperparameter, ...] = ()
    for name, (low, high) in vary.items():
        if name in options:
            continue
        values = np.geomspace(low, high, TRIED).tolist()
        scores = [tuned({**given, name: one}, True).log_density for one in values]
        best, median = values[int(np.argmax(scores))], float(np.sqrt(low * high))
        told, at_end = max(scores) - min(scores) > 0.5, best in (values[0], values[-1])
        one = Hyperparameter(f"option_{name}", best, median, np.nan, told, at_end)
        given, varied = given | {name: best}, (*varied, one)
    return replace(tuned(given, False), varied=varied)


def _tuned(
    build: Callable[[Scene], Formulation] | None, whole: Formulation, small: Formulation
) -> _Candidate:
    """The most likely hyperparameters, over a basis that is large enough for them."""
    rows = TuningRows.of(small)
    variance, largest = rows.variance(), FIRST_SIGNAL
    grid = 1.0
    if whole.scene is not small.scene:
        # rescale the weights to the prior variance on the grid of the fit
        grid = variance / TuningRows.of(whole).variance()
    weights = {t.name: t.weight for t in whole.terms if t.measures}
    usual = np.array([weights[name] for name in rows.terms]) / grid
    # whether boundary values count and their scale was fitted to the forces
    fitted = whole.scene_parameters.keys() - whole.scene.not_identified.keys()
    free = build is not None and BOUNDARY_SCALE in fitted
    while True:
        judge = PlaceLeftOut(
            rows.over_basis(largest / variance),
            *(len(rows.terms), variance, largest, rows.highest, free),
        )
        steps, spread = judge.best([usual])
        most = float(judge.values(steps)[0].max()) * variance
        if most < NEARLY * largest or largest > FIRST_SIGNAL:
            break
        largest *= LARGER
    return _Candidate(build, whole, rows, judge, steps, spread, usual, grid)

"""The weights of a fit: chosen from its recordings where possible, else its own.

The values of the option ``weights`` are the same for a fit, a session, the demo and the
experiment: "auto" chooses, "own" keeps the weights of the formulation. Without a
formulation, `default_model` takes a depth map, which chooses its own hyperparameters.
Of others, `tune` finds the weights that predict places left out best. Recordings of too
few frames or of one place cannot: a `TtusWarning` gives the reason, and the
formulation's own weights are used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ttus_opt.contact.scene import BOUNDARY_SCALE, Scene
from ttus_opt.core.errors import InputError, warn
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.fitting.checks.zero_check import on_zero, warn_of_zero
from ttus_opt.fitting.uncertainty.contact_spread import (
    SPOT,
    contact_spread,
    pressed_places,
)
from ttus_opt.fitting.weights.tuning import tune
from ttus_opt.fitting.weights.tuning_result import Tuning
from ttus_opt.problem.formulation import DEFAULT, Formulation, load, option_defaults
from ttus_opt.problem.terms.depth_map import DepthMapTerm
from ttus_opt.problem.terms.depth_map_estimate import PRIOR, UnusableForcesError
from ttus_opt.problem.terms.drag_estimate import estimate_shown
from ttus_opt.problem.terms.part_noise import TURN
from ttus_opt.problem.terms.wrench import ForceTerm
from ttus_opt.voxmap.sampling import least_length, sized

Word = Literal["auto", "own"]

AUTO: Literal["auto"] = "auto"
OWN: Literal["own"] = "own"

WORDS: tuple[Word, ...] = (AUTO, OWN)

#: Fewest frames in contact for three or four hyperparameters [–]
LEAST_FRAMES = 12

#: The default model without and with drag
DEPTH_MAPS = ("depth_map", "depth_map_coulomb")


@dataclass(frozen=True)
class WeightChoice:
    """The problem to fit: ``fit(choice.scene, choice.formulation)``.

    Attributes:
        scene: With the chosen boundary scale.
        formulation: With the chosen weights, or its own.
        tuning: The tuning behind them; None for the formulation's own weights.
        reason: Why its own weights are used; empty where they were tuned or requested.
        reasons: A model that chooses its own hyperparameters, in words.
    """

    scene: Scene = field(repr=False)
    formulation: Formulation
    tuning: Tuning | None = field(default=None, repr=False)
    reason: str = ""
    reasons: tuple[str, ...] = ()

    def as_dict(self) -> dict[str, Any]:
        """The choice and its uncertainty, for JSON."""
        weights = {t.name: t.weight for t in self.formulation.terms if t.measures}
        if self.tuning is None:
            return {
                "by": "marginal likelihood" if self.reasons else "formulation",
                "weights": weights,
                "model": list(self.reasons),
                "reason": self.reason,
                "held_out": [],
            }
        return {
            "by": "places left out",
            "reason": "",
            "weights": weights,
            "weight_factors": dict(self.tuning.weight_factors),
            "hyperparameters": {h.name: asdict(h) for h in self.tuning.hyperparameters},
            "not_determined": list(self.tuning.not_determined),
            "noise_N": self.tuning.noise,
            "left_out_force_error_N": self.tuning.left_out_force_error,
            "held_out": [asdict(self.tuning.check)],
            "tuned_on": list(self.tuning.shape),
            "seconds": self.tuning.seconds,
        }

    @property
    def lines(self) -> tuple[str, ...]:
        """The same in words."""
        if self.tuning is None:
            return self.reasons
        factors = self.tuning.weight_factors
        weights = ", ".join(
            f"{name} {weight:.3g} (×/÷ {factors[name]:.2f})"
            for name, weight in self.tuning.weights.items()
        )
        lines = [
            f"weights chosen from the recordings: {weights}, for an error of a force "
            f"component of {self.tuning.noise:.2f} N at places left out"
        ]
        unknown = self.tuning.not_determined
        names = ", ".join(name for name in unknown if name != BOUNDARY_SCALE)
        if names:
            lines.append(f"hardly determined by the recordings: {names}")
        if BOUNDARY_SCALE in unknown:
            lines.append(
                f"{BOUNDARY_SCALE} kept as the Laplace field alone fits the forces; "
                "places left out leave it open"
            )
        ends = [h for h in self.tuning.hyperparameters if h.at_bound]
        lines += [f"{h.name} ended at its bound, {h.value:.3g}" for h in ends]
        return (*lines, str(self.tuning.check))


def has_weights(formulation: str | Path | Formulation) -> bool:
    """Whether it is given by name and has weights with default values.

    Others have their weights already, have none, or choose them themselves.
    """
    if isinstance(formulation, Formulation):
        return False
    usual = (option_defaults(formulation) or {}).items()
    values = [value for name, value in usual if is_weight(name)]
    return bool(values) and None not in values


def checked_word(word: str, words: Sequence[str] = WORDS) -> str:
    """Return a known word.

    Raises:
        InputError: It is not among ``words``.
    """
    if word not in words:
        choices = f"{', '.join(words[:-1])} or {words[-1]}"
        raise InputError(f"weights={word!r} is not known: take {choices}")
    return word


def word_for(
    word: str | None,
    formulation: str | Path | Formulation | None,
    options: Mapping[str, Any],
) -> str:
    """The given word; by default "auto" where that is possible, else "own".

    Args:
        word: One of `WORDS`, or None.
        formulation: The given formulation, or None.
        options: The given options of the formulation.

    Raises:
        InputError: Another word, "auto" with a weight, or an unknown formulation.
    """
    given = [name for name in options if is_weight(name)]
    if word is not None:
        if checked_word(word) == AUTO and given:
            raise InputError(
                f'weights="auto" chooses {given[0]}: give one or the other'
            )
        return word
    can = formulation is None or has_weights(formulation)
    if not can and isinstance(formulation, str | Path):  # a depth map, or a user's
        can = formulation in DEPTH_MAPS or Path(formulation).suffix == ".py"
    return AUTO if can and not given else OWN


def is_weight(option: str) -> bool:
    """Whether an option of a formulation is the weight of a term."""
    return option.endswith("_weight")


def choice_of(
    word: str,
    scene: Scene,
    formulation: str | Path | Formulation | None = None,
    options: Mapping[str, Any] | None = None,
    *,
    sampling: str | None = None,
    strict: bool = True,
    progress: Callable[[str], None] | None = None,
) -> WeightChoice:
    """The problem to fit.

    Args:
        word: One of `WORDS`.
        scene: Patient, probe and measurements.
        formulation: The formulation; None for the default model (`default_model`), or
            with own weights for the default formulation.
        options: Options of the formulation.
        sampling: Of the default model; None for the most likely one.
        strict: Whether a formulation that cannot be tuned is an error instead of a
            warning.
        progress: Called with a message for every step.

    Raises:
        InputError: As in `word_for`, or an unknown formulation or option, or one that
            cannot be tuned.
    """
    options = options or {}
    word_for(word, formulation, options)
    if word == AUTO and formulation is None:
        return default_model(scene, options, sampling, progress=progress)
    warn_of_zero(scene)
    if word == OWN:
        usual = DEFAULT if formulation is None else formulation
        return WeightChoice(scene, load(usual, scene, **options))
    assert formulation is not None
    declared = load(formulation, scene, **options)
    if any(isinstance(term, DepthMapTerm) for term in declared.terms):
        return WeightChoice(scene, declared, reasons=described(declared))
    reason = too_little(scene)
    if reason:
        return _own(scene, declared, reason)
    try:
        tuned = tune(scene, formulation, compare=False, progress=progress, **options)
    except InputError as error:
        if strict:
            raise
        return _own(scene, declared, str(error))
    return WeightChoice(tuned.scene, tuned.formulation, tuned)


def default_model(
    scene: Scene,
    options: Mapping[str, Any] | None = None,
    sampling: str | None = None,
    *,
    progress: Callable[[str], None] | None = None,
) -> WeightChoice:
    """The model of a fit with no choice of the user's: a depth map.

    With drag where the recordings show it, in the most likely sampling, without the
    bias of a sensor that was not zeroed, on a skin where forces begin (`on_zero`).
    Where no depth map explains the forces, the default formulation with its own
    weights, and a warning with the reason.

    Args:
        scene: Patient, probe and measurements.
        options: Options of the depth map, without weights.
        sampling: How contact samples the field; None for the most likely one.
        progress: Called with a message for every step.

    Raises:
        InputError: Options that the depth map does not have.
    """
    given, told = dict(options or {}), progress or (lambda step: None)
    scene = on_zero(scene)
    try:
        with one_blas_thread():  # for matrices of a few hundred rows
            told("sampling and drag")
            likely, dragged = likely_sampling(scene, given)
            sampling, name = sampling or likely, DEPTH_MAPS[dragged]
            place = scene if scene.sampling == sampling else scene.resampled(sampling)
            told(f"{name}, {sampling} sampling")
            declared = load(name, place, **given)
    except UnusableForcesError as error:
        return _own(scene, load(DEFAULT, scene), str(error))
    return WeightChoice(place, declared, reasons=described(declared))


def likely_sampling(
    scene: Scene, options: Mapping[str, Any] | None = None
) -> tuple[str, bool]:
    """The most likely sampling of a depth map, and whether drag acts.

    The sampling is `contact-size` with its length ℓ₀: the stiffness per area of tissue
    that is deep relative to the probe decreases with the length of the contact, that of
    a thin layer does not. ℓ₀ is estimated with the other hyperparameters, and drag
    where it acts.

    Args:
        scene: Patient, probe and measurements.
        options: Of the depth map; hyperparameters among them are not estimated.

    Raises:
        UnusableForcesError: No depth map explains the forces.
    """
    if scene.sampling == "voxel-mean":
        scene = scene.resampled("trilinear")
    held: dict[str, Any] = {name: (options or {}).get(name) for name in PRIOR}
    held["resampled"] = True
    drag, found = estimate_shown(scene, **held)
    return sized(found.least_length), drag is not None


def described(model: Formulation) -> tuple[str, ...]:
    """A depth map and its errors, in words."""
    prior = next(term for term in model.terms if isinstance(term, DepthMapTerm))
    least = least_length(prior.scene.sampling)
    force = next((t for t in model.terms if isinstance(t, ForceTerm) and t.noise), None)
    lines = [
        f"{model.name}, by marginal likelihood: φ = {prior.profile} N/cm², varies by "
        f"{100 * prior.deviation:.0f} % over {1e3 * prior.surface_length:.0f} mm along "
        f"the skin and {1e3 * prior.depth_length:.0f} mm in depth"
    ]
    if force is not None:
        assert force.noise is not None
        lines.append(
            f"error of a normal force {force.noise.level:.2g} N, of its direction "
            f"{np.degrees(TURN):.0f}°"
        )
        if lost := float(np.max(np.abs(force.noise.lost))):
            lines.append(
                f"forces moved by up to {lost:.2g} N, which the tracker's noise takes "
                "from them: a probe that is reported deep is so partly by error"
            )
    if least:
        lines.append(
            f"stiffness per area is that of a thin layer for contacts shorter than "
            f"{1e3 * least:.1f} mm"
        )
    return tuple(lines)


def _own(scene: Scene, declared: Formulation, reason: str) -> WeightChoice:
    """A formulation with its own weights, and a warning with the reason."""
    weights = (f"{t.name} {t.weight:g}" for t in declared.terms if t.measures)
    warn(
        f"weights were not chosen from the recordings: {reason}; the weights of "
        f"{declared.name} are used ({', '.join(weights)})",
        2,
    )
    return WeightChoice(scene, declared, reason=reason)


def too_little(scene: Scene) -> str:
    """Why the recordings cannot determine weights; empty where they may."""
    touching = scene.touching
    if not touching.any():
        return "the probe touches the patient in no frame"
    if touching.sum() < LEAST_FRAMES:
        return (
            f"frames in contact: {touching.sum()}, {LEAST_FRAMES} are needed: record "
            "longer"
        )
    if BOUNDARY_SCALE in scene.not_identified:
        return scene.not_identified[BOUNDARY_SCALE]
    count = len(np.unique(scene.presses[touching]))
    spread = contact_spread(scene)
    if count == 1 and spread < scene.shell.rms_radius:
        return (
            f"one press within {1e3 * spread:.0f} mm, less than the probe's own size, "
            "says nothing about other places: press at several"
        )
    if spread < SPOT:
        return f"all presses within {1e3 * spread:.1f} mm: press at several places"
    if len(np.unique(pressed_places(scene)[touching])) == 1:
        return (
            "all frames are of one place, which nothing predicts: lift the probe and "
            "press at several"
        )
    return ""

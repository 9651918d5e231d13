"""The values of the option ``weights``, and the problem that each selects.

They are the same for a fit, a session, the demo and the experiment: "auto" chooses the
weights of a formulation, or the default model where none is named (`weight_choice`),
"own" keeps the weights of the formulation.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from ttus_opt.errors import InputError
from ttus_opt.fitting.batch import DEFAULT_FORMULATION
from ttus_opt.fitting.weight_choice import (
    WeightChoice,
    choose_weights,
    has_choice,
    is_weight,
    refuse_weights,
)
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import Scene

Word = Literal["auto", "own"]

AUTO: Literal["auto"] = "auto"
OWN: Literal["own"] = "own"

WORDS: tuple[Word, ...] = (AUTO, OWN)


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
    if word is not None:
        checked_word(word)
    if word == AUTO:
        refuse_weights(options)
    if word is not None:
        return word
    can = formulation is None or (
        not isinstance(formulation, Formulation) and has_choice(formulation)
    )
    return AUTO if can and not any(map(is_weight, options)) else OWN


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
        formulation: As in `choose_weights`.
        options: Options of the formulation.
        sampling: As in `choose_weights`.
        strict: As in `choose_weights`.
        progress: Called with a message for every step.

    Raises:
        InputError: As in `word_for` and `choose_weights`.
    """
    options = options or {}
    word_for(word, formulation, options)
    if word == OWN:
        own = DEFAULT_FORMULATION if formulation is None else formulation
        return WeightChoice(scene, shelf.load(own, scene, **options))
    return choose_weights(
        scene,
        formulation,
        options,
        sampling=sampling,
        strict=strict,
        progress=progress,
    )

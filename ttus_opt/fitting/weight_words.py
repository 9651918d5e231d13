"""The words that ``weights`` takes, and what is fitted by each.

A fit, a session, the demo and the experiment take the same words: "auto" chooses the
weights of one formulation (`weight_choice`), "recipe" formulation and sampling as well
(`recipe`), "own" leaves a formulation its own.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from ttus_opt.errors import InputError
from ttus_opt.fitting.batch import USUAL
from ttus_opt.fitting.recipe import choose_recipe
from ttus_opt.fitting.weight_choice import (
    WeightChoice,
    choose_weights,
    has_choice,
    is_weight,
)
from ttus_opt.problem import formulation as shelf
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import Scene

Word = Literal["auto", "recipe", "own"]

AUTO: Literal["auto"] = "auto"
RECIPE: Literal["recipe"] = "recipe"
OWN: Literal["own"] = "own"

WORDS: tuple[Word, ...] = (AUTO, RECIPE, OWN)


def checked_word(word: str, words: Sequence[str] = WORDS) -> str:
    """A word that stands in a list.

    Raises:
        InputError: It does not.
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
    """The word asked for; where there is none "auto", if nothing stands against it.

    Args:
        word: One of `WORDS`; None where none was given.
        formulation: What to fit; None where none was given.
        options: Of the formulation, as given.

    Raises:
        InputError: Another word, "auto" beside a weight, "recipe" beside a formulation
            or an option, or an unknown formulation.
    """
    if word is not None:
        checked_word(word)
    if word == RECIPE and (formulation is not None or options):
        raise InputError(
            'weights="recipe" chooses the formulation and its options: leave both out'
        )
    given = [name for name in options if is_weight(name)]
    if word == AUTO and given:
        raise InputError(f'weights="auto" chooses {given[0]}: give one or the other')
    if word is not None:
        return word
    can = formulation is None or (
        not isinstance(formulation, Formulation) and has_choice(formulation)
    )
    return AUTO if can and not given else OWN


def choice_of(
    word: str,
    scene: Scene,
    formulation: str | Path | Formulation | None = None,
    options: Mapping[str, Any] | None = None,
    *,
    strict: bool = True,
    progress: Callable[[str], None] | None = None,
) -> WeightChoice:
    """What is fitted by a word.

    Args:
        word: One of `WORDS`.
        scene: Patient, probe and measurements.
        formulation: As of `choose_weights`; None also for the recipe.
        options: Of the formulation; none for the recipe.
        strict: As of `choose_weights`.
        progress: Called with what begins.

    Raises:
        InputError: As of `word_for` and `choose_weights`.
    """
    options = options or {}
    word_for(word, formulation, options)
    if word == RECIPE:
        return choose_recipe(scene, progress=progress)
    if word == OWN:
        own = USUAL if formulation is None else formulation
        return WeightChoice(scene, shelf.load(own, scene, **options))
    return choose_weights(scene, formulation, options, strict=strict, progress=progress)

"""What stands for ``weights``: the words, what they do, and what they refuse."""

from __future__ import annotations

from typing import Any

import pytest

import ttus_opt as tt
from tests.conftest import small_scene
from ttus_opt.errors import InputError
from ttus_opt.fitting import weight_words
from ttus_opt.fitting.weight_choice import WeightChoice
from ttus_opt.fitting.weight_words import WORDS, choice_of, word_for
from ttus_opt.scene import Scene

WEIGHT = {"force_weight": 1.0}


@pytest.mark.parametrize(
    ("formulation", "options", "word"),
    [
        (None, {}, "auto"),
        ("eq10", {}, "auto"),
        ("depth_map", {}, "auto"),
        ("laplace_only", {}, "own"),
        ("eq10", WEIGHT, "own"),
        (None, WEIGHT, "own"),
    ],
)
def test_the_word_where_none_is_given(
    formulation: str | None, options: dict[str, float], word: str
) -> None:
    assert word_for(None, formulation, options) == word
    assert word_for("own", formulation, options) == "own"


@pytest.mark.parametrize(
    ("word", "formulation", "options", "told"),
    [
        (
            "recipe",
            None,
            {},
            "weights='recipe' is not known: take auto or own",
        ),
        ("auto", "eq10", WEIGHT, "chooses force_weight: give one or the other"),
    ],
)
def test_words_that_cannot_be_followed(
    word: Any, formulation: str | None, options: dict[str, float], told: str
) -> None:
    with pytest.raises(InputError, match=told):
        word_for(word, formulation, options)
    with pytest.raises(InputError, match=told):
        tt.fit(small_scene("trilinear"), formulation, weights=word, **options)


def test_own_weights() -> None:
    scene = small_scene("trilinear")
    choice = choice_of("own", scene, options=WEIGHT)
    assert choice.formulation.name == "eq10" and choice.tuning is None
    assert {t.name: t.weight for t in choice.formulation.terms}["force"] == 1.0
    assert tt.fit(scene).formulation == "eq10"


@pytest.mark.parametrize("word", WORDS)
def test_a_fit_takes_what_the_word_chose(
    word: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def chosen(name: str) -> Any:
        def choose(scene: Scene, *_: object, **__: object) -> WeightChoice:
            other = scene.with_boundary(2.0, 1.0)
            return WeightChoice(other, tt.load_formulation(name, other))

        return choose

    monkeypatch.setattr(weight_words, "choose_weights", chosen("tikhonov"))
    names = {"own": "eq10", "auto": "tikhonov"}
    scene = small_scene("trilinear")
    assert tt.fit(scene, weights=word).formulation == names[word]

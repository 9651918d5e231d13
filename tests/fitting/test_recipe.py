"""What is tried by the recipe, and that presses left out decide."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.fitting.test_tuning import drawn, tuned
from ttus_opt.fitting import recipe
from ttus_opt.fitting.left_out import Check, LeftOut
from ttus_opt.fitting.recipe import better_weights, choose_recipe, resampled
from ttus_opt.fitting.weight_choice import WeightChoice
from ttus_opt.problem.formulation import Formulation
from ttus_opt.scene import Scene

FOUR = [
    ("eq10", "trilinear"),
    ("depth_map", "trilinear"),
    ("eq10", "contact-size"),
    ("depth_map", "contact-size"),
]


@pytest.mark.parametrize("best", FOUR)
def test_the_smallest_error_on_presses_left_out_is_fitted(
    best: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def left_out(name: str, scene: Scene) -> LeftOut:
        size = 0.1 if (name, scene.sampling) == best else 0.2
        return replace(
            tuned().left_out, model=name, errors=np.full(len(touching), size)
        )

    def chosen(scene: Scene, *_: object, **__: object) -> WeightChoice:
        own = left_out("eq10", scene)
        check = Check.between(own, own, presses)
        declared = tt.load_formulation("eq10", scene)
        return WeightChoice(scene, declared, checks=(check,), left_out=own)

    def depth_map(declared: Formulation) -> LeftOut:
        return left_out(declared.name, declared.scene)

    touching, presses = tuned().left_out.frames, np.arange(15) // 5
    monkeypatch.setattr(recipe, "choose_weights", chosen)
    monkeypatch.setattr(recipe, "left_out_of", depth_map)
    choice = choose_recipe(drawn())
    assert (choice.formulation.name, choice.scene.sampling) == best
    assert len(choice.checks) == 4
    told = [check.richer for check in choice.checks[1:]]
    assert told == [f"{name} ({sampling})" for name, sampling in FOUR[1:]]


@pytest.mark.parametrize("worse", [True, False])
def test_its_own_weights_are_taken_where_they_predict_better(worse: bool) -> None:
    found = tuned()
    errors = found.own_left_out.errors
    likeliest = replace(found.left_out, errors=(1.01 if worse else 0.99) * errors)
    check = Check.between(likeliest, found.own_left_out, np.arange(15) // 5)
    choice = WeightChoice(
        found.scene, found.formulation, found, checks=(check,), left_out=likeliest
    )
    taken = better_weights(choice, drawn())
    weights = [term.weight for term in taken.formulation.terms if term.measures]
    assert weights == ([0.01, 0.01] if worse else list(found.weights.values()))
    assert taken.left_out is (found.own_left_out if worse else likeliest)


def test_a_scene_in_another_sampling_has_its_own_scale() -> None:
    scene = drawn()
    other = resampled(scene, "contact-size")
    assert other.sampling == "contact-size" and other.voxmap is scene.voxmap
    assert abs(other.N - scene.N).max() > 0.0
    fitted = Scene.assemble(
        scene.voxmap, scene.shell, scene.trajectory, sampling="contact-size"
    )
    assert other.inner == pytest.approx(fitted.inner) != scene.inner
    known = resampled(scene.with_boundary(2.0, 3.0), "contact-size")
    assert (known.inner, known.outer) == (2.0, 3.0)


@pytest.mark.slow
def test_the_recipe_fits() -> None:
    choice = choose_recipe(drawn())
    assert len(choice.checks) == 4
    assert tt.fit(choice.scene, choice.formulation).status is tt.Status.SOLVED

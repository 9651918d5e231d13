"""Tuning against data whose noise, boundary scale and friction are known."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import ttus_opt as tt
from tests.conftest import small_scene, torso
from tests.fitting.test_weight_criteria import three_presses
from tests.test_blas_threads import threads
from ttus_opt.errors import InputError
from ttus_opt.fitting import tuning, tuning_series
from ttus_opt.fitting.tuning import Tuning, tune
from ttus_opt.scene import Scene
from ttus_opt.voxmap.voxmap import Voxmap

NOISE, SCALE = 0.02, 1.4


@functools.cache
def drawn() -> Scene:
    """Forces and torques of a field drawn from the prior, and white noise."""
    scene, rng = three_presses(), np.random.default_rng(1)
    L = scene.L.toarray()
    p = np.linalg.solve(L, SCALE * scene.b + 0.3 * rng.normal(size=len(scene.b)))
    force = (scene.N @ p).reshape(-1, 3) + rng.normal(0.0, NOISE, (15, 3))
    noise = NOISE * scene.torque_length
    torque = (scene.W @ p).reshape(-1, 3) + rng.normal(0.0, noise, (15, 3))
    trajectory = replace(scene.trajectory, force=force, torque=torque)
    return Scene.assemble(scene.voxmap, scene.shell, trajectory, inner="fit")


@functools.cache
def tuned() -> Tuning:
    return tune(drawn(), "eq10")


def test_noise_and_scale_are_found() -> None:
    found = tuned()
    assert found.noise == pytest.approx(NOISE, rel=0.5)
    named = {h.name: h for h in found.hyperparameters}
    scale = named["boundary_scale"]
    assert scale.determined
    assert scale.value == pytest.approx(2.0 * SCALE, abs=3.0 * scale.spread)
    assert found.scene.inner == found.scene.parameters["boundary_scale"] == scale.value
    weights = {t.name: t.weight for t in found.formulation.terms if t.measures}
    assert weights == found.weights


def test_fit_with_weights_auto_is_the_fit_of_what_was_found() -> None:
    found = tuned()
    expected = tt.fit(found.scene, found.formulation)
    field = tt.fit(drawn(), "eq10", weights="auto")
    np.testing.assert_allclose(field.candidate, expected.candidate, rtol=1e-6)
    assert field.parameters["boundary_scale"] == found.scene.inner


def test_other_criteria_choose_multiples_of_the_weights() -> None:
    names = [one.criterion for one in tuned().comparisons]
    assert names == ["left_out_force_error", "gcv"]
    for one in tuned().comparisons:
        ratio = one.weights["force"] / tuned().weights["force"]
        assert np.abs(np.log10(ratio / tuning.FACTORS)).min() < 1e-9
    best, _ = tuned().comparisons
    assert best.left_out_force_error <= tuned().left_out_force_error * (1.0 + 1e-9)


def test_of_two_formulations_the_likelier_is_taken() -> None:
    found = tune(drawn(), ["eq10", "coulomb_global"], compare=False)
    assert found.formulation.name == "eq10"  # nothing slides
    assert found.simpler is not None and found.simpler.simpler is None
    assert found.simpler.formulation.name == "coulomb_global"  # it comes after
    assert set(found.candidates) == {"eq10", "coulomb_global"}
    assert found.log_marginal == max(found.candidates.values())


def test_forces_alone_are_tuned() -> None:
    own = drawn()
    silent = replace(own.trajectory, torque=None)
    scene = Scene.assemble(own.voxmap, own.shell, silent, inner="fit")
    found = tune(scene, "eq10", compare=False)
    assert found.weights.keys() == {"force"} == found.weight_factors.keys()
    assert found.noise == pytest.approx(NOISE, rel=0.7)
    assert 0.2 < found.weights["force"] / tuned().weights["force"] < 5.0


def test_one_thread_does_the_dense_algebra() -> None:
    seen: list[set[int]] = []
    with threadpool_limits(limits=2, user_api="blas"):
        tune(drawn(), "eq10", compare=False, progress=lambda _: seen.append(threads()))
    assert seen and all(one == {1} for one in seen)


@pytest.mark.slow
def test_an_option_is_chosen_among_others() -> None:
    found = tune(drawn(), "free_surface", compare=False)
    option = next(h for h in found.hyperparameters if h.name == "option_skin")
    assert 1e-7 < option.value < 1.0
    prior = next(t for t in found.formulation.terms if not t.measures)
    assert prior.skin == option.value  # type: ignore[attr-defined]


def test_a_coarse_grid_finds_nearly_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = drawn()
    monkeypatch.setattr(tuning_series, "MOST_VOXELS", scene.n_voxels // 2)
    found = tune(scene, "eq10", compare=False)
    assert np.prod(found.shape) < scene.n_voxels
    ratio = found.weights["force"] / tuned().weights["force"]
    assert 0.2 < ratio < 5.0
    assert found.formulation.scene.n_voxels == scene.n_voxels


def prior_variance(scene: Scene) -> float:
    """Mean of N (LᵀL)⁻¹ Nᵀ's diagonal in contact, by dense algebra."""
    N = scene.N.toarray()[np.repeat(scene.rows.contact_points > 0, 3)]
    return float(np.square(np.linalg.solve(scene.L.toarray().T, N.T)).sum() / len(N))


def test_what_another_grid_finds_is_rescaled_by_its_prior(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Half of the layers: the same rows have several times the prior variance."""
    scene, own = drawn(), {"force_weight": 3.0, "torque_weight": 1.0}
    voxmap = Voxmap.from_surface(torso(), shape=(5, 20, 10), r_inner=0.03)
    small = Scene.assemble(voxmap, scene.shell, scene.trajectory, inner="fit")
    there = tune(small, "eq10")
    monkeypatch.setattr(tuning, "coarser", lambda _: small)
    found = tune(scene, "eq10", **own)
    grid = found.variance / there.variance
    assert not 0.4 < grid < 2.5
    # eight random probes
    assert grid == pytest.approx(prior_variance(small) / prior_variance(scene), rel=0.3)
    assert found.noise == there.noise
    for one, other in zip(
        (found, *found.comparisons), (there, *there.comparisons), strict=True
    ):
        for name, weight in one.weights.items():
            assert weight == pytest.approx(grid * other.weights[name], rel=1e-6)
    monkeypatch.undo()
    same = {name: weight / grid for name, weight in own.items()}
    known = tune(small, "eq10", compare=False, **same).own_left_out
    np.testing.assert_allclose(found.own_left_out.errors, known.errors, rtol=1e-6)
    np.testing.assert_array_equal(found.left_out.errors, there.left_out.errors)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"formulation": "coulomb_drag"}, "cannot be tuned"),
        ({"force_weight": 1.0}, "chooses force_weight"),
        ({"weights": "evidence"}, "take auto or own"),
    ],
)
def test_what_cannot_be_tuned_is_refused(given: dict, told: str) -> None:  # type: ignore[type-arg]
    with pytest.raises(InputError, match=told):
        tt.fit(drawn(), **{"weights": "auto", **given})


def test_without_contact_nothing_is_tuned() -> None:
    scene = small_scene("trilinear")
    away = replace(scene.trajectory, position=scene.trajectory.position * 1.3)
    with pytest.warns(tt.TtusWarning, match="Laplace field alone"):
        off = Scene.assemble(scene.voxmap, scene.shell, away, inner=1.0)
    with pytest.raises(InputError, match="measured in contact"):
        tune(off)

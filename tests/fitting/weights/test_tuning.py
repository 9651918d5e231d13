"""Tuning against data whose noise, boundary scale and friction are known."""

import functools
from dataclasses import dataclass, replace
from typing import ClassVar

import numpy as np
import pytest
from threadpoolctl import threadpool_limits

import ttus_opt as tt
from tests.core.test_threads import threads
from tests.kit import InputError, refuses, small_scene, three_presses, torso
from ttus_opt.fitting.uncertainty.contact_spread import pressed_places
from ttus_opt.fitting.weights import coarse_scene, tuning
from ttus_opt.problem.terms.laplace import LaplaceTerm

NOISE, SCALE = 0.02, 1.4


@functools.cache
def drawn(shape=None):
    """Forces and torques of a field drawn from the prior, and white noise."""
    small = shape and small_scene("trilinear", shape=shape, n_poses=15)
    scene, rng = small or three_presses(), np.random.default_rng(1)
    L = scene.L.toarray()
    p = np.linalg.solve(L, SCALE * scene.b + 0.3 * rng.normal(size=len(scene.b)))
    force = (scene.N @ p).reshape(-1, 3) + rng.normal(0.0, NOISE, (15, 3))
    noise = NOISE * scene.torque_length
    torque = (scene.W @ p).reshape(-1, 3) + rng.normal(0.0, noise, (15, 3))
    trajectory = replace(scene.trajectory, force=force, torque=torque)
    return tt.Scene.assemble(scene.voxmap, scene.shell, trajectory, inner="fit")


@functools.cache
def tuned():
    return tt.tune(drawn(), "eq10")


def test_the_scale_is_found():
    found = tuned()
    named = {h.name: h for h in found.hyperparameters}
    scale = named["boundary_scale"]
    assert scale.determined
    assert scale.value == pytest.approx(2.0 * SCALE, abs=3.0 * scale.spread)
    assert found.scene.inner == found.scene.parameters["boundary_scale"] == scale.value
    weights = {t.name: t.weight for t in found.formulation.terms if t.measures}
    assert weights == found.weights


def test_the_errors_are_those_of_fits_without_a_place():
    """Of the weights chosen and of the formulation's own, by fits."""
    found, own = tuned(), tt.load_formulation("eq10", drawn())
    place, means = pressed_places(drawn()), {}
    # the scale is estimated for each of the weights; its own weights' is not told
    for label, declared in (("chosen", found.formulation), ("own", own)):
        scene, by_place = declared.scene, []
        weights = {t.name: t.weight for t in declared.terms if t.measures}
        touching = scene.rows.contact_points > 0
        for number in np.unique(place[touching]):
            out = place == number
            rows = replace(
                scene.rows, N=scene.N[np.repeat(~out, 3)], W=scene.W[np.repeat(~out, 3)]
            )
            kept = scene.trajectory.select(~out)
            options = {f"{name}_weight": w for name, w in weights.items()}
            fitted = tt.fit(
                replace(scene, trajectory=kept, rows=rows), "eq10", **options
            )
            off = (scene.f - scene.N @ fitted.candidate).reshape(-1, 3)[out & touching]
            by_place.append(np.linalg.norm(off, axis=1).mean())
        means[label] = np.mean(by_place)
    assert found.check.places == len(by_place)
    assert found.check.chosen_error == pytest.approx(means["chosen"], rel=0.02)
    assert found.check.own_error == pytest.approx(means["own"], rel=0.3)
    assert found.left_out_force_error == found.check.chosen_error
    assert "places left out better than with its own weights" in str(found.check)


def test_errors_that_differ_by_less_than_their_own_are_about_as_large():
    alike = replace(tuned().check, difference_error=1e3)
    assert "about as well as with its own weights" in str(alike)
    worse = replace(tuned().check, own_error=0.0, difference_error=0.0)
    assert "worse than with its own weights" in str(worse)
    assert worse.own_error == 0.0


def test_fit_with_weights_auto_is_the_fit_of_what_was_found():
    found = tuned()
    expected = tt.fit(found.scene, found.formulation)
    field = tt.fit(drawn(), "eq10", weights="auto")
    np.testing.assert_allclose(field.candidate, expected.candidate, rtol=1e-6)
    assert field.parameters["boundary_scale"] == found.scene.inner


def test_other_criteria_choose_multiples_of_the_weights():
    names = [one.criterion for one in tuned().comparisons]
    assert names == ["log_evidence", "gcv"]
    for one in tuned().comparisons:
        ratio = one.weights["force"] / tuned().weights["force"]
        assert np.abs(np.log10(ratio / tuning.FACTORS)).min() < 1e-9
        assert one.left_out_force_error > 0.0


def test_without_sliding_drag_is_not_taken():
    found = tt.tune(drawn(), ["coulomb_global", "eq10"], compare=False)
    assert found.formulation.name == "eq10"
    assert set(found.candidates) == {"eq10", "coulomb_global"}
    assert found.candidates["eq10"] == found.left_out_force_error


@dataclass(frozen=True)
class OwnForceTerm(tt.terms.ForceTerm):
    """A user's term, whose rows are forces in another unit."""

    name: ClassVar[str] = "own_force"

    def rows(self):
        given = super().rows()
        blocks = {name: 3.0 * M for name, M in given.blocks.items()}
        return tt.AffineRows(blocks, 3.0 * given.target)


def test_a_users_own_terms_are_tuned():
    """By their rows alone: in another unit the weight is another, the fit the same."""
    scene = tuned().scene
    plain = tt.Formulation([LaplaceTerm(scene), tt.terms.ForceTerm(scene)])
    own = tt.Formulation([LaplaceTerm(scene), OwnForceTerm(scene)]).named("mine")
    weights = [tt.tune(scene, each, compare=False).weights for each in (plain, own)]
    ratio = weights[0]["force"] / weights[1]["own_force"]
    assert ratio == pytest.approx(9.0, rel=0.5)
    solution = tt.fit(scene, own, weights="auto")
    assert solution.weights["own_force"] == weights[1]["own_force"]
    assert solution.formulation == "mine"
    with pytest.raises(InputError, match="belongs to another scene"):
        tt.fit(drawn(), own, weights="auto")


def test_a_users_file_is_tuned(tmp_path):
    file = tmp_path / "mine.py"
    file.write_text(
        "from ttus_opt import Formulation\n"
        "from ttus_opt.problem.terms import ForceTerm, LaplaceTerm\n"
        "def build(scene):\n"
        "    return Formulation([LaplaceTerm(scene), ForceTerm(scene, 0.5)])\n",
        encoding="utf-8",
    )
    solution = tt.fit(drawn(), file, weights="auto")
    assert solution.weights["force"] != 0.5
    assert "mine with the weights chosen predicts" in solution.chosen[-1]


def test_forces_alone_are_tuned():
    own = drawn()
    silent = replace(own.trajectory, torque=None)
    scene = tt.Scene.assemble(own.voxmap, own.shell, silent, inner="fit")
    found = tt.tune(scene, "eq10", compare=False)
    assert found.weights.keys() == {"force"} == found.weight_factors.keys()
    assert 0.2 < found.weights["force"] / tuned().weights["force"] < 5.0


def test_one_thread_does_the_dense_algebra():
    seen = []
    with threadpool_limits(limits=2, user_api="blas"):
        tt.tune(
            drawn(), "eq10", compare=False, progress=lambda _: seen.append(threads())
        )
    assert seen and all(one == {1} for one in seen)


def test_an_option_at_the_end_of_its_range_is_told():
    ridges = {"ridge": (1e2, 1e4)}  # the less the better
    found = tt.tune(drawn((5, 8, 5)), "tikhonov", vary=ridges, compare=False)
    option = found.hyperparameters[-1]
    assert (option.name, option.value, option.at_bound) == ("option_ridge", 1e2, True)


@pytest.mark.slow
def test_an_option_is_chosen_among_others():
    found = tt.tune(drawn(), "free_surface", compare=False)
    option = next(h for h in found.hyperparameters if h.name == "option_skin")
    assert 1e-7 < option.value < 1.0
    prior = next(t for t in found.formulation.terms if not t.measures)
    assert prior.skin == option.value


def test_a_coarse_grid_finds_nearly_the_same(monkeypatch):
    scene, usual = drawn(), tuned()  # others have it too: not of the coarse grid
    monkeypatch.setattr(coarse_scene, "MOST_VOXELS", scene.n_voxels // 2)
    found = tt.tune(scene, "eq10", compare=False)
    assert np.prod(found.shape) < scene.n_voxels
    ratio = found.weights["force"] / usual.weights["force"]
    assert 0.2 < ratio < 5.0
    assert found.formulation.scene.n_voxels == scene.n_voxels


def prior_variance(scene):
    """Mean of N (LᵀL)⁻¹ Nᵀ's diagonal in contact, by dense algebra."""
    N = scene.N.toarray()[np.repeat(scene.rows.contact_points > 0, 3)]
    return float(np.square(np.linalg.solve(scene.L.toarray().T, N.T)).sum() / len(N))


def test_what_another_grid_finds_is_rescaled_by_its_prior(monkeypatch):
    """Half of the layers: the same rows have several times the prior variance."""
    scene, own = drawn(), {"force_weight": 3.0, "torque_weight": 1.0}
    voxmap = tt.Voxmap.from_surface(torso(), shape=(5, 20, 10), r_inner=0.03)
    small = tt.Scene.assemble(voxmap, scene.shell, scene.trajectory, inner="fit")
    there = tt.tune(small, "eq10")
    monkeypatch.setattr(tuning, "coarser", lambda _: small)
    found = tt.tune(scene, "eq10", **own)
    grid = found.weights["force"] / there.weights["force"]
    assert not 0.4 < grid < 2.5
    # eight random probes
    assert grid == pytest.approx(prior_variance(small) / prior_variance(scene), rel=0.3)
    assert found.noise == pytest.approx(there.noise, rel=0.01)
    for one, other in zip(
        (found, *found.comparisons), (there, *there.comparisons), strict=True
    ):
        for name, weight in one.weights.items():
            assert weight == pytest.approx(grid * other.weights[name], rel=0.01)
    monkeypatch.undo()
    same = {name: weight / grid for name, weight in own.items()}
    known = tt.tune(small, "eq10", compare=False, **same).check
    assert found.check.own_error == pytest.approx(known.own_error, rel=1e-3)


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"formulation": "coulomb_drag"}, "cannot be tuned: .* beside the field"),
        ({"formulation": "robust"}, "cannot be tuned: its term robust_force is no sum"),
        ({"formulation": "laplace_only"}, "takes no measurements and has no weights"),
        ({"force_weight": 1.0}, "chooses force_weight"),
        ({"weights": "evidence"}, "take auto or own"),
    ],
)
def test_what_cannot_be_tuned_is_refused(given, told):
    refuses(InputError, told, tt.fit, drawn(), **{"weights": "auto", **given})


def without_contact():
    scene = small_scene("trilinear")
    away = replace(scene.trajectory, position=scene.trajectory.position * 1.3)
    with pytest.warns(tt.TtusWarning, match="Laplace field alone"):
        return tt.Scene.assemble(scene.voxmap, scene.shell, away, inner=1.0)


def test_without_contact_nothing_is_tuned():
    refuses(InputError, "measured in contact", tt.tune, without_contact())

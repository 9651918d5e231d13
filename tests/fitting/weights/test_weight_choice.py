"""When a fit's weights are chosen from its recordings, and why not."""

import warnings
from dataclasses import asdict, replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.fitting.uncertainty.test_contact_spread import scene_of
from tests.fitting.weights.test_tuning import drawn, tuned, without_contact
from tests.kit import (
    InputError,
    TtusWarning,
    dragged_scene,
    presses,
    refuses,
    small_scene,
    torso,
)
from ttus_opt import example
from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.fitting.weights import weight_choice
from ttus_opt.fitting.weights.weight_choice import (
    WORDS,
    WeightChoice,
    choice_of,
    has_weights,
    word_for,
)
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.terms.depth_map import DepthMapTerm
from ttus_opt.problem.terms.depth_map_estimate import estimate_depth_map
from ttus_opt.problem.terms.drag_estimate import estimate_drag, estimate_dragged
from ttus_opt.problem.terms.wrench import ForceTerm
from ttus_opt.voxmap.sampling import least_length, sized

OWN = {"force": 1e-2, "torque": 1e-2}


def weights(choice):
    return {t.name: t.weight for t in choice.formulation.terms if t.measures}


def refused(scene, told):
    """The choice for a scene that cannot bear one; it has the formulation's own."""
    with pytest.warns(TtusWarning, match=told):
        choice = choice_of("auto", scene, "eq10")
    assert choice.tuning is None and choice.scene is scene
    assert weights(choice) == OWN
    assert choice.as_dict()["by"] == "formulation"
    assert choice.reason in choice.as_dict()["reason"]
    assert choice.lines == ()
    return choice


def test_what_is_chosen_is_what_tune_finds_and_says_how_sure():
    choice = choice_of("auto", drawn(), "eq10")
    assert weights(choice) == tuned().weights
    assert choice.scene.inner == tuned().scene.inner
    told = choice.as_dict()
    assert told["by"] == "places left out" and told["weights"] == tuned().weights
    assert told["weight_factors"] == tuned().weight_factors
    assert told["weight_factors"]["torque"] >= told["weight_factors"]["force"] > 1.0
    assert told["hyperparameters"].keys() == {h.name for h in tuned().hyperparameters}
    assert told["held_out"] == [asdict(tuned().check)]
    assert choice.lines[0].startswith("weights chosen from the recordings: force ")
    assert choice.lines[-1] == str(tuned().check)


def test_what_stays_open_is_told_with_the_value_that_is_kept():
    """As is a hyperparameter that ran to the end of its range."""
    choice = choice_of("auto", drawn(), "eq10")
    first = replace(tuned().hyperparameters[0], determined=True)
    scale = "boundary_scale"
    lines = {}
    for names in ((), ("mu",), (scale,), ("mu", scale)):
        open_ones = (replace(first, name=name, determined=False) for name in names)
        tuning = replace(choice.tuning, hyperparameters=(first, *open_ones))
        lines[names] = replace(choice, tuning=tuning).lines[1:-1]
    assert lines[()] == ()
    assert lines["mu",] == ("hardly determined by the recordings: mu",)
    (told,) = lines[scale,]
    assert told.startswith("boundary_scale kept as the Laplace field alone fits")
    assert lines["mu", scale] == (*lines["mu",], told)
    ended = replace(first, determined=True, at_bound=True)
    tuning = replace(choice.tuning, hyperparameters=(ended,))
    (told,) = replace(choice, tuning=tuning).lines[1:-1]
    assert told == f"signal_to_noise ended at its bound, {first.value:.3g}"


def test_without_contact():
    told = "touches the patient in no frame; the weights of eq10 are used"
    refused(without_contact(), told)


def test_too_few_frames():
    scene = small_scene("trilinear")
    few = scene.trajectory.select(np.arange(12) < 4)
    refused(
        Scene.assemble(scene.voxmap, scene.shell, few, inner=1.0),
        "frames in contact: 4, 12 are needed",
    )


def test_forces_of_the_wrong_sign():
    own = drawn().trajectory
    flipped = replace(own, force=-own.force, torque=-own.torque)
    with pytest.warns(TtusWarning, match="push into the patient"):
        scene = Scene.assemble(drawn().voxmap, drawn().shell, flipped)
    refused(scene, "chosen from the recordings: the forces push into the patient")


@pytest.mark.parametrize("lifted", [False, True])
def test_one_press_and_presses_at_one_place(lifted):
    rng = np.random.default_rng(1)
    angle = 1.5 + rng.uniform(-0.01, 0.01, 30)
    depth = rng.uniform(0.004, 0.012, 30)
    if lifted:
        depth[14:16] = -0.02
    told = "all presses within" if lifted else "one press within"
    refused(scene_of(angle, np.full(30, 0.1), depth), told)


@pytest.mark.slow
def test_drag_in_the_recordings_is_chosen_together_with_the_weights():
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TtusWarning)
        clean = dragged_scene("contact")
    rng, n = np.random.default_rng(4), len(clean.trajectory)
    noisy = replace(
        clean.trajectory,
        force=clean.trajectory.force + rng.normal(0.0, 0.05, (n, 3)),
        torque=clean.trajectory.torque + rng.normal(0.0, 1e-3, (n, 3)),
    )
    scene = Scene.assemble(clean.voxmap, clean.shell, noisy)
    choice = choice_of("auto", scene, "coulomb_global")
    named = {h.name: h for h in choice.tuning.hyperparameters}
    assert named["friction_coefficient"].value == pytest.approx(0.3, abs=0.03)


@pytest.mark.slow
def test_the_default_is_a_depth_map_in_the_likeliest_sampling():
    """The same by name in that scene; with drag where the recordings show it."""
    choice = choice_of("auto", drawn())
    assert choice.formulation.name == "depth_map" and choice.tuning is None
    assert "by marginal likelihood" in choice.lines[0]
    assert choice.as_dict()["by"] == "marginal likelihood"
    found = choice.scene.sampling
    likely = {
        each: estimate_depth_map(drawn().resampled(each)).log_evidence
        for each in (found, "contact-size", "trilinear")
    }
    # forces of a field that is sampled by no size: nearly as likely, for ℓ₀'s prior
    assert likely[found] > likely["trilinear"] - 1.0 > likely["contact-size"]
    assert f"shorter than {1e3 * least_length(found):.1f} mm" in choice.lines[-1]
    named = choice_of("auto", choice.scene, "depth_map")
    assert str(named.formulation) == str(choice.formulation)
    assert (
        choice_of("auto", drawn(), sampling="voxel-mean").scene.sampling == "voxel-mean"
    )
    found = tt.fit(drawn(), weights="auto")
    assert found.field.sampling == choice.scene.sampling
    assert found.chosen == choice.lines
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TtusWarning)
        dragged = choice_of("auto", dragged_scene("contact"))
    assert dragged.formulation.name == "depth_map_coulomb"


def test_where_drag_acts_is_found_and_given_options_come_first(monkeypatch):
    """It is looked for in trilinear sampling, with the length of the contact's size."""
    looked, asked = [], []
    estimate, load = weight_choice.estimate_shown, weight_choice.load

    def noted(name, scene, **options):
        asked.append((name, scene.sampling, options))
        return load(name, scene, **options)

    def looking(scene, **options):
        drag, found = estimate(scene, **options)
        looked.append((scene.sampling, sized(found.least_length)))
        assert drag is not None
        return drag, found

    monkeypatch.setattr(weight_choice, "estimate_shown", looking)
    monkeypatch.setattr(weight_choice, "load", noted)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TtusWarning)
        weight_choice.default_model(dragged_scene("contact"))
        weight_choice.default_model(dragged_scene("contact"), {"acts_at": "reference"})
    (at, sampling), again = looked
    assert at == "trilinear" and (at, sampling) == again
    assert sampling.startswith("contact-size:")
    assert asked == [
        ("depth_map_coulomb", sampling, given)
        for given in ({}, {"acts_at": "reference"})
    ]


@pytest.mark.slow
def test_the_sampling_is_that_of_drag_where_the_depth_map_has_it():
    """Of the example's sweep, which a Laplace field takes for drag of every point."""
    surface = tt.Surface.load(example.path("surface.nc"))
    names = "press_fit.csv", "sweep_drag_fit.csv"
    recordings = [tt.read_trajectory(example.path(name)) for name in names]
    shell = tt.PointShell.from_spec(example.PROBE)
    plan = ScenePlan((14, 40, 18), sampling="trilinear")
    scene = plan.build(surface, shell, recordings)
    assert estimate_drag(scene).acts_at == "points"
    at = {
        where: sized(estimate_dragged(scene, where, resampled=True)[1].least_length)
        for where in ("points", "contact")
    }
    assert at["points"] != at["contact"]
    assert weight_choice.likely_sampling(scene) == (at["contact"], True)


def test_forces_that_no_depth_map_explains_leave_eq10():
    pulling = replace(drawn().trajectory, force=-drawn().f.reshape(-1, 3))
    scene = Scene.assemble(drawn().voxmap, drawn().shell, pulling, inner=1.0)
    with pytest.warns(TtusWarning, match="pull the probe in.*weights of eq10"):
        choice = choice_of("auto", scene)
    assert choice.formulation.name == "eq10" and "pull" in choice.reason


def test_a_formulation_that_cannot_be_tuned_keeps_its_weights():
    with pytest.warns(TtusWarning, match=r"coulomb_drag cannot be tuned.*are used"):
        choice = choice_of("auto", drawn(), "coulomb_drag", strict=False)
    assert choice.tuning is None and weights(choice) == OWN
    refuses(InputError, "cannot be tuned", choice_of, "auto", drawn(), "coulomb_drag")
    with pytest.raises(InputError, match="has no option"):
        choice_of("auto", drawn(), "eq10", {"strength": 1.0})


def test_weights_that_were_given_are_nothing_to_choose(tmp_path):
    assert has_weights("eq10") and has_weights("coulomb_global")
    assert not has_weights("laplace_only")
    assert not has_weights("depth_map")  # chooses its own
    for name, word in (
        ("depth_map", "auto"),
        ("eq10", "auto"),
        ("laplace_only", "own"),
    ):
        assert word_for(None, name, {}) == word
    own = tmp_path / "own.py"
    own.write_text("def build(scene, strength: float = 1.0): ...\n", encoding="utf-8")
    assert not has_weights(own)
    assert word_for(None, own, {"strength": 2.0}) == "auto"
    assert word_for(None, str(own), WEIGHT) == "own"
    declared = tt.load_formulation("eq10", drawn())
    assert isinstance(declared, tt.Formulation) and not has_weights(declared)
    with pytest.raises(InputError, match="chooses force_weight"):
        choice_of("auto", drawn(), "eq10", {"force_weight": 1.0})


def test_a_library_fit_has_the_weights_it_names():
    poses = presses(torso(), 20, np.random.default_rng(0))
    scene = Scene.assemble(small_scene("trilinear").voxmap, drawn().shell, poses)
    solution = tt.fit(scene, "eq10")
    assert {n: solution.weights[n] for n in OWN} == OWN


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
def test_the_word_where_none_is_given(formulation, options, word):
    assert word_for(None, formulation, options) == word
    assert word_for("own", formulation, options) == "own"


@pytest.mark.parametrize(
    ("word", "formulation", "options", "told"),
    [
        ("recipe", None, {}, "weights='recipe' is not known: take auto or own"),
        ("auto", "eq10", WEIGHT, "chooses force_weight: give one or the other"),
    ],
)
def test_words_that_cannot_be_followed(word, formulation, options, told):
    refuses(InputError, told, word_for, word, formulation, options)
    with pytest.raises(InputError, match=told):
        tt.fit(small_scene("trilinear"), formulation, weights=word, **options)


def test_own_weights():
    scene = small_scene("trilinear")
    choice = choice_of("own", scene, options=WEIGHT)
    assert choice.formulation.name == "eq10" and choice.tuning is None
    assert {t.name: t.weight for t in choice.formulation.terms}["force"] == 1.0
    assert tt.fit(scene).formulation == "eq10"


@pytest.mark.parametrize("word", WORDS)
def test_a_fit_takes_what_the_word_chose(word, monkeypatch):
    def choose(scene, *_, **__):
        other = scene.with_boundary(2.0, 1.0)
        return WeightChoice(other, tt.load_formulation("tikhonov", other))

    monkeypatch.setattr(weight_choice, "default_model", choose)
    names = {"own": "eq10", "auto": "tikhonov"}
    scene = small_scene("trilinear")
    assert tt.fit(scene, weights=word).formulation == names[word]


def test_forces_that_were_moved_for_errors_of_depths_are_told():
    scene = small_scene("contact-size", n_poses=60)
    found = estimate_depth_map(scene)
    for error, told in ((0.0, False), (1e-3, True)):
        noise = replace(found, depth_error=error).part_noise(scene)
        terms = [DepthMapTerm.of(scene, found), ForceTerm(scene, noise=noise)]
        lines = weight_choice.described(Formulation(terms=terms))
        assert any("forces moved by up to" in line for line in lines) == told

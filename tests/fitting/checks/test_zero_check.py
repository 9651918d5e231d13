"""A sensor that was not zeroed, and a skin that is not where forces begin."""

import warnings
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import MistakeWarning
from ttus_opt import example
from ttus_opt.contact.scene import ScenePlan
from ttus_opt.fitting.checks.zero_check import _onset, on_zero, sensor_bias, skin_offset
from ttus_opt.fitting.weights.weight_choice import choice_of, default_model

PLAN = ScenePlan((16, 48, 24), 0.03)
SURFACE = tt.Surface.load(example.path("surface.nc"))
SHELL = tt.PointShell.from_spec(example.PROBE, n_points=300)
PRESS, SWEEP, UNSEEN = (
    tt.read_trajectory(example.path(f"{name}.csv"))
    for name in ("press_fit", "sweep_fit", "press_test")
)
NOISE = np.random.default_rng(0).normal(0.0, 0.1, PRESS.force.shape)
NOISY = replace(PRESS, force=PRESS.force + NOISE)


def scene_on(height, recordings=(PRESS, SWEEP)):
    """The example with its skin moved by a height [m]."""
    return PLAN.build(SURFACE.raised(height), SHELL, recordings)


def test_the_bias_of_a_sensor_is_told_and_taken_off():
    """It turns with the probe; noise alone has none."""
    scene = PLAN.build(SURFACE, SHELL, NOISY)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert on_zero(scene) is scene
    bias = np.array([0.0, -0.2, 0.4]), np.array([0.01, 0.0, -0.02])
    shown = [NOISY.rotation @ part for part in bias]
    biased = replace(
        NOISY, force=NOISY.force + shown[0], torque=NOISY.torque + shown[1]
    )
    said = r"shows \(-?0.0\d, -0.[12]\d, 0.[34]\d\) N .* that touch nothing"
    with pytest.warns(MistakeWarning, match=said) as told:
        mended = on_zero(PLAN.build(SURFACE, SHELL, biased))
    assert len(told) == 1  # where forces begin is not to be told before
    np.testing.assert_allclose(mended.f, scene.f, atol=0.06)  # of 46 frames of 0.1 N
    np.testing.assert_allclose(mended.tau, scene.tau, atol=2e-3)
    assert mended.inner == pytest.approx(scene.inner, rel=0.02)
    with pytest.warns(MistakeWarning, match="Take its bias off with ttus-opt comp"):
        choice_of("own", PLAN.build(SURFACE, SHELL, biased), "eq10")


@pytest.mark.parametrize("moved", [-3e-3, -12e-3])
@pytest.mark.parametrize("recordings", [(PRESS,), (PRESS, SWEEP)])
def test_a_low_skin_is_no_bias(moved, recordings):
    assert sensor_bias(scene_on(moved, recordings)) is None


@pytest.mark.parametrize("moved", [-12e-3, -3e-3, 3e-3, 12e-3])
def test_forces_tell_by_how_much_the_skin_is_wrong(moved):
    found = skin_offset(scene_on(moved))
    assert found == pytest.approx(-moved, abs=4e-4)


@pytest.mark.parametrize(
    "recordings", [(PRESS, SWEEP), (NOISY,), (SWEEP,), (PRESS.select(slice(0, 8)),)]
)
def test_nothing_is_told_where_forces_begin_on_the_skin_or_do_not_show_it(recordings):
    assert skin_offset(scene_on(0.0, recordings)) is None


def test_recordings_that_do_not_show_the_onset_tell_nothing():
    """Neither a sweep in contact all the time, nor presses without their approach."""
    scene = scene_on(-3e-3)
    deep = scene.trajectory.select(np.linalg.norm(scene.f.reshape(-1, 3), axis=1) > 1)
    assert skin_offset(scene_on(-3e-3, (deep,))) is None
    assert skin_offset(scene_on(-3e-3, (SWEEP,))) is None


@pytest.mark.parametrize("height", [-3.0, 0.5, 2.0])
@pytest.mark.parametrize("exponent", [1.4, 1.8])
def test_the_onset_of_a_power_law(height, exponent):
    """f = k (d + h)₊ᵇ with a factor per press and noise: h within 0.25 mm."""
    rng = np.random.default_rng(7)
    depth = np.tile(np.linspace(-6.0, 9.0, 40), 12)
    stiffness = np.repeat(0.2 * rng.lognormal(0.0, 0.25, 12), 40)
    force = stiffness * np.maximum(depth + height, 0.0) ** exponent
    found = _onset(depth, force + rng.normal(0.0, 0.05, len(depth)), 0.05)
    if abs(height) < 1.0:
        assert found is None
    else:
        assert 1e3 * found == pytest.approx(height, abs=0.25)


def test_the_default_moves_the_skin_to_where_forces_begin():
    """The error at presses it has not seen is that on the right skin, not twice it."""

    def error(scene, formulation):
        found = tt.fit(scene, formulation).field
        force = tt.evaluate(found, SHELL, UNSEEN).rendered_force
        size = np.linalg.norm(UNSEEN.force, axis=1)
        wrong = np.abs(np.linalg.norm(force, axis=1) - size)
        return wrong[size > 0.5].mean()

    wrong = scene_on(-3e-3)
    with pytest.warns(MistakeWarning, match=r"begin [23]\.\d mm above .* is moved"):
        moved = default_model(wrong)
    right = default_model(scene_on(0.0))
    np.testing.assert_allclose(
        moved.scene.voxmap.surface.radius, SURFACE.radius, atol=4e-4
    )
    expected = error(right.scene, right.formulation)
    assert error(moved.scene, moved.formulation) < 1.2 * expected
    assert error(wrong, "depth_map") > 2.0 * expected


def test_a_formulation_that_is_asked_for_keeps_the_skin():
    scene = scene_on(-3e-3)
    with pytest.warns(
        MistakeWarning, match=r"begin [23]\.\d mm above the skin: .* without a form"
    ):
        choice = choice_of("own", scene, "eq10")
    assert choice.scene is scene

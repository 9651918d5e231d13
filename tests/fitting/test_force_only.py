"""Recordings of forces alone: the fit is that without torque rows, everywhere."""

import functools
from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import presses, torso, with_wrenches
from ttus_opt.contact.scene import ScenePlan
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.checks.sanity import check_recordings


@functools.cache
def scenes():
    """The same presses, with torques and without."""
    surface = torso()
    shell = tt.PointShell.from_spec("ellipsoid:0.02,0.015,0.015", n_points=200)
    own = presses(surface, 12, np.random.default_rng(1))
    plan = ScenePlan((12, 16, 10), inner=5.0, sampling="trilinear")
    whole = plan.build(surface, shell, own)
    return whole, plan.build(surface, shell, replace(own, torque=None))


@pytest.mark.parametrize("solver", ["structured", "closed_form", "clarabel"])
def test_the_fit_is_that_of_forces_alone(solver):
    whole, only = scenes()
    expected = tt.fit(whole, "eq10", solver=solver, force_weight=1.0, torque_weight=0.0)
    found = tt.fit(only, "eq10", solver=solver, force_weight=1.0, torque_weight=1.0)
    np.testing.assert_allclose(found.field.values, expected.field.values, atol=1e-6)
    with_torques = tt.fit(whole, "eq10", force_weight=1.0, torque_weight=1.0)
    difference = with_torques.field.values - found.field.values
    assert np.abs(difference).max() > 1e-3  # torques would have said something


@pytest.mark.parametrize("name", ["eq10_sign", "robust", "viscous_drag", "tikhonov"])
def test_other_formulations(name):
    _, only = scenes()
    assert tt.fit(only, name).status is tt.Status.SOLVED


def test_the_recursion_and_its_updates():
    whole, only = scenes()
    batch = tt.fit(only, "eq10", force_weight=1.0)
    recursion = tt.RecursiveFit(only, force_weight=1.0, torque_weight=1.0)
    np.testing.assert_allclose(
        recursion.field.values, batch.field.values, atol=1e-7, rtol=0
    )
    first = only.trajectory
    told = recursion.update(first.rotation[0], first.position[0], first.force[0])
    assert told.components == ("fx", "fy", "fz")
    other = tt.RecursiveFit(whole)
    with pytest.raises(InputError, match="torque_weight=0"):
        other.update(first.rotation[0], first.position[0], first.force[0])


def test_evaluation_and_report_say_that_there_are_none():
    whole, only = scenes()
    field = tt.fit(only, "eq10", force_weight=1.0).field
    errors = tt.evaluate(field, only.shell, only.trajectory).errors
    expected = tt.evaluate(field, whole.shell, whole.trajectory).errors
    assert errors.force_magnitude_error_N == expected.force_magnitude_error_N
    assert np.isnan(errors.torque_magnitude_error_Nm)
    assert errors.frames_with_torque == 0
    report = check_recordings(only, field)
    assert report.mistake is None
    assert "no torques" in report.lines[0]
    assert "forces" in repr(only)


def test_a_flipped_sensor_of_forces_is_told():
    _, only = scenes()
    wrong = with_wrenches(only, -only.f)
    report = check_recordings(wrong, tt.fit(wrong, "laplace_only").field)
    assert report.mistake.mends == "--flip-wrench"

"""The recursion equals Gaussian conditioning of all nodes at once, and learns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

import ttus_opt as tt
from tests.kit import InputError, refuses
from ttus_opt import example
from ttus_opt.contact.rows import contact_rows
from ttus_opt.fitting.recursion import recursive_depth_map as module
from ttus_opt.fitting.recursion.recursive_depth_map import RecursiveDepthMap
from ttus_opt.problem.terms.depth_profile import DepthProfile

PRIOR = DepthProfile((1.3,), (5.0,))


@pytest.fixture(scope="module")
def patient():
    surface = tt.Surface.load(example.path("surface.nc"))
    return tt.Voxmap.from_surface(surface, shape=(24, 72, 30), r_inner=0.03)


@pytest.fixture(scope="module")
def shell():
    return tt.PointShell.from_spec(example.PROBE, n_points=200)


def recording(name):
    return tt.read_trajectory(example.path(f"{name}.csv"))


def fold(model, recorded, start=0.0, twist=None, stride=1):
    for i in range(0, len(recorded), stride):
        model.update(
            start + recorded.time[i],
            recorded.rotation[i],
            recorded.position[i],
            np.r_[recorded.force[i], recorded.torque[i]],
            twist=None if twist is None else twist[i],
        )
    return model


def error(model, shell, name):
    errors = tt.evaluate(model.field, shell, recording(name)).errors
    return errors.force_magnitude_error_N


def test_equals_conditioning_of_all_nodes(shell, monkeypatch):
    surface = tt.Surface.load(example.path("surface.nc"))
    patient = tt.Voxmap.from_surface(surface, shape=(12, 32, 14), r_inner=0.06)
    monkeypatch.setattr(module, "_noise", lambda *_: 0.3 * np.eye(6))
    monkeypatch.setattr(module, "DISAGREES", 1e9)
    model = RecursiveDepthMap(patient, shell, PRIOR, memory=np.inf, surface_length=0.08)
    press = recording("press_fit")
    fold(model, press, stride=16)
    lattice = model.lattice
    full = lattice.over_skin, lattice.over_depth
    prior = block_diag(np.eye(2), model.deviation**2 * np.kron(*full))
    kept = slice(0, None, 16)
    poses = press.rotation[kept], press.position[kept]
    rows = contact_rows(patient, shell, *poses, sampling=model.sampling)
    phi = model._phi
    powers = np.stack([3.0 * phi, 0.2 * 1.3 * model._log_depth * phi], axis=1)
    basis = np.hstack([powers, phi[:, None] * lattice.weights.toarray()])
    rows_of = [rows.N.toarray(), rows.W.toarray() / shell.rms_radius]
    H = np.vstack([one @ basis for one in rows_of])
    measured = np.concatenate(
        [press.force[kept].ravel(), press.torque[kept].ravel() / shell.rms_radius]
    )
    offset = np.concatenate([one @ phi for one in rows_of])
    spread = H @ prior @ H.T + 0.3 * np.eye(len(H))
    mean = prior @ H.T @ np.linalg.solve(spread, measured - offset)
    state = model.state
    scale, slope = 1.0 + 3.0 * mean[0], 0.26 * mean[1]
    assert state.scale == pytest.approx(scale, abs=1e-6)
    assert state.slope == pytest.approx(slope, abs=1e-6)
    np.testing.assert_allclose(state.stiffness.ravel(), mean[2:], atol=1e-5)


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_wrong_prior_becomes_right(patient, shell, factor):
    prior = DepthProfile((1.3,), (5.0 * factor,))
    model = RecursiveDepthMap(patient, shell, prior)
    before = error(model, shell, "press_test")
    fold(model, recording("press_fit"), stride=2)
    assert error(model, shell, "press_test") < min(0.36, 0.5 * before)


@pytest.mark.parametrize(
    ("fitted", "unseen", "most"),
    [("press_fit", "press_test", 0.12), ("sweep_fit", "press_test", 0.3)],
)
def test_predicts_what_was_not_pressed(patient, shell, fitted, unseen, most):
    """All at once err by 0.08 and 0.14 N; without the contact's size 0.20, 0.44."""
    model = fold(RecursiveDepthMap(patient, shell, PRIOR), recording(fitted), stride=2)
    assert error(model, shell, unseen) < most


def test_learns_friction(patient, shell):
    slid = recording("sweep_drag_fit")
    model = RecursiveDepthMap(patient, shell, PRIOR)
    assert model.friction == 0.0
    fold(model, slid, twist=slid.twist(), stride=4)
    assert model.friction == pytest.approx(example.DRAG, abs=0.04)
    assert model.field.parameters["friction_coefficient"] == model.friction


def test_no_friction_where_there_is_none(patient, shell):
    slid = recording("sweep_fit")
    model = RecursiveDepthMap(patient, shell, PRIOR)
    fold(model, slid, twist=slid.twist(), stride=4)
    assert model.friction < 0.03


def test_a_press_and_its_release_are_one_stiffness(patient, shell):
    """Strokes on a field whose points rub: μ comes out, and no stroke undoes it."""
    stiffer = RecursiveDepthMap(patient, shell, DepthProfile((1.5,), (4.0,))).field
    law = {"friction_coefficient": 0.25, "drag_at_points": 1.0}
    truth = tt.Renderer(replace(stiffer, parameters=law), shell)
    press = recording("press_fit")
    deepest = int(np.linalg.norm(press.force, axis=1).argmax())
    R, at = press.rotation[deepest], press.position[deepest]
    outward = press.force[deepest] / np.linalg.norm(press.force[deepest])
    model, found = RecursiveDepthMap(patient, shell, PRIOR), []
    for k in range(8 * 20):
        stroke, step = divmod(k, 20)
        pressing = stroke % 2 == 0
        lifted = 5e-4 * (20 - step if pressing else step)
        speed = np.r_[outward * (-0.01 if pressing else 0.01), np.zeros(3)]
        pose = R, at + lifted * outward
        felt = truth.render(*pose, speed)
        model.update(0.05 * k, *pose, np.r_[felt.force, felt.torque], twist=speed)
        if step == 19 and stroke >= 2:
            bare = tt.Renderer(replace(model.field, parameters={}), shell)
            found.append(np.linalg.norm(bare.render(R, at + 3e-3 * outward).force))
    assert model.friction == pytest.approx(0.25, abs=0.03)
    assert np.ptp(found) < 0.02 * np.mean(found)


def test_size_follows_the_area_not_the_measurements(patient, shell):
    press = recording("press_fit")
    model = fold(RecursiveDepthMap(patient, shell, PRIOR), press, stride=4)
    once = model.memory_bytes
    for turn in range(1, 3):
        fold(model, press, start=turn * 20.0, stride=4)
    assert model.memory_bytes == once


def test_stiffness_fades_and_the_law_stays(patient, shell):
    model = RecursiveDepthMap(patient, shell, PRIOR, memory=60.0)
    press = fold(model, recording("press_fit"), stride=4)
    before = press.state
    known = press.uncertainty.relative
    away = np.array([10.0, 0.0, 0.0])
    model.update(3600.0, np.eye(3), away, np.zeros(6))
    assert np.abs(model.state.stiffness).max() < 1e-6
    assert model.state.scale == before.scale
    assert model.uncertainty.relative.min() > known.min()


def test_uncertainty_is_least_where_it_was_touched(patient, shell):
    press = recording("press_fit")
    model = fold(RecursiveDepthMap(patient, shell, PRIOR), press, stride=4)
    stated = model.uncertainty
    touched = press.position[np.linalg.norm(press.force, axis=1).argmax()]
    assert stated.at(*touched) < 0.6 * stated.at(0.0, -0.1, touched[2])


def test_a_wild_measurement_counts_less(patient, shell):
    press = recording("press_fit")
    model = fold(RecursiveDepthMap(patient, shell, PRIOR), press, stride=4)
    before = error(model, shell, "press_test")
    hardest = np.linalg.norm(press.force, axis=1).argmax()
    wild = model.update(
        30.0,
        press.rotation[hardest],
        press.position[hardest],
        np.r_[20.0 * press.force[hardest], press.torque[hardest]],
    )
    assert wild.counts < 0.05
    assert error(model, shell, "press_test") < before + 0.3


@pytest.mark.parametrize(
    ("time", "wrench", "said"),
    [
        (-1.0, np.zeros(6), "go back"),
        (np.nan, np.zeros(6), "go back"),
        (1.0, np.full(6, np.nan), "finite"),
        (1.0, np.zeros(3), "6 finite"),
        (1.0, np.full(6, 1e200), "6 finite"),  # its square is infinite
    ],
)
def test_refuses_unusable_measurements(patient, shell, time, wrench, said):
    model = RecursiveDepthMap(patient, shell, PRIOR)
    model.update(0.0, np.eye(3), np.array([10.0, 0, 0]), np.zeros(6))
    refuses(InputError, said, model.update, time, np.eye(3), np.zeros(3), wrench)


@pytest.mark.parametrize("twist", [np.zeros(5), np.full(6, np.nan)])
def test_refuses_unusable_twists_before_any_time_has_passed(patient, shell, twist):
    model = RecursiveDepthMap(patient, shell, PRIOR)
    pose = np.eye(3), np.zeros(3), np.ones(6)
    refuses(InputError, "twist must be 6", model.update, 1.0, *pose, twist=twist)
    model.update(0.5, *pose)


def test_refuses_a_law_of_several_powers(patient, shell):
    with pytest.raises(InputError, match="one power"):
        RecursiveDepthMap(patient, shell, DepthProfile((1.0, 2.0), (1.0, 1.0)))
    with pytest.raises(InputError, match="must be positive"):
        RecursiveDepthMap(patient, shell, PRIOR, surface_length=-1.0)

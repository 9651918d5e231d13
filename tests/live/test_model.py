"""What a live model learns from presses, without a link."""

from dataclasses import replace

import hypothesis
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.live.springy import PLAN, Spring, parts
from ttus_opt import example
from ttus_opt.live.feedback import ModelFeedback
from ttus_opt.live.messages import MessageError, Sample
from ttus_opt.live.model import (
    STEP,
    USUAL_LAW,
    LiveModel,
    ModelPlan,
    _twist,
    decode_model,
    encode_model,
)
from ttus_opt.live.patient import SimulatedPatient
from ttus_opt.live.subject import example_subject, patient_surface, probe_shell
from ttus_opt.live.tissue import ElasticTorso
from ttus_opt.message import decode

#: The hand gives way, so that it is not as deep as it intends [m]
FRICTION, LIFTED = 0.25, np.array([0.0, 0.008, 0.0])


def test_presses_alone_tell_friction_from_stiffness():
    # a press is a tenth larger than its release: drag along the probe's flanks
    law = replace(USUAL_LAW, coefficients=(1.6 * USUAL_LAW.coefficients[0],))
    model = LiveModel(patient_surface(), probe_shell(), ModelPlan(law=law))
    patient, still = SimulatedPatient(ElasticTorso(FRICTION)), ElasticTorso()
    path = example_subject().examination()
    samples = []
    for time, R, p in zip(path.time, path.rotation, path.position, strict=True):
        samples.append(patient.sense(time, R, p + LIFTED))
        model.fold(samples[-1])
    assert model.learner.friction == pytest.approx(FRICTION, abs=0.1)
    feel = ModelFeedback(model.field, probe_shell())
    for sample in samples[-60::5]:
        place = sample.rotation, sample.position
        true = np.linalg.norm(still.wrench(*place, np.zeros(3))[:3])
        if true > 2.0:
            assert np.linalg.norm(feel.at(*place)[:3]) == pytest.approx(true, rel=0.06)


def test_the_twist_between_two_samples():
    omega, velocity, dt = np.array([0.4, -0.2, 0.7]), np.array([0.03, 0.0, -0.01]), 0.02
    start = Rotation.from_rotvec([0.3, 1.0, -0.5])
    turned = Rotation.from_rotvec(dt * omega) * start
    one = Sample(1.0, start.as_matrix(), np.zeros(3), np.zeros(6))
    two = Sample(1.0 + dt, turned.as_matrix(), dt * velocity, np.zeros(6))
    twist = _twist(one, two)
    np.testing.assert_allclose(twist, [*velocity, *omega], rtol=1e-4, atol=1e-12)
    assert _twist(two, one) is None


def learned():
    _, shell, (sent, _) = parts()
    model, patient = LiveModel(decode(sent), shell, PLAN), Spring()
    for k in range(40):
        depth = 0.015 * np.sin(0.1 * k) ** 2
        at = np.array([0.12 - depth, 0.0, 0.12 + 0.002 * k])
        model.fold(patient.sense(0.02 * k, np.eye(3), at))
    return model


def test_a_model_survives_within_its_rounding():
    model = learned()
    content = encode_model(model)
    far = decode_model(content, model.surface, model.shell)
    here, there = model.learner.state, far.learner.state
    assert np.abs(here.stiffness).max() > 10 * STEP
    np.testing.assert_allclose(there.stiffness, here.stiffness, atol=0.5 * STEP + 1e-6)
    assert there.scale == pytest.approx(here.scale, rel=1e-6)
    at = np.array([0.11, 0.0, 0.15])
    forces = [
        tt.Renderer(one.field, model.shell).render(np.eye(3), at, np.zeros(6)).force
        for one in (model, far)
    ]
    np.testing.assert_allclose(*forces, rtol=0.01, atol=0.02)


def test_a_whole_model_of_a_torso_takes_less_than_five_kilobytes():
    surface = tt.Surface.load(example.path("surface.nc"))
    shell = tt.PointShell.from_spec(example.PROBE, n_points=300)
    model = LiveModel(surface, shell, ModelPlan())
    start = 0.0
    for name in ("press_fit", "sweep_fit"):
        one = tt.read_trajectory(example.path(f"{name}.csv"))
        for i in range(0, len(one), 4):
            wrench = np.r_[one.force[i], one.torque[i]]
            model.fold(
                Sample(start + one.time[i], one.rotation[i], one.position[i], wrench)
            )
        start += 30.0
    assert model.learner.touched > 40
    assert len(encode_model(model)) < 5000


@given(st.binary(max_size=200))
def test_arbitrary_content_is_refused(data):
    model = learned_once()
    with pytest.raises(MessageError):
        decode_model(data, model.surface, model.shell)


@given(st.integers(0, 10_000), st.integers(0, 255))
@hypothesis.example(13, 128)  # a negative exponent
@hypothesis.example(13, 68)  # one of hundreds
def test_changed_content_is_refused_or_a_finite_model(place, value):
    model = learned_once()
    content = bytearray(encode_model(model))
    content[place % len(content)] = value
    try:
        found = decode_model(bytes(content), model.surface, model.shell)
    except MessageError:
        return
    assert np.isfinite(found.field.values).all()


def learned_once(_kept=[]):  # noqa: B006
    if not _kept:
        _kept.append(learned())
    return _kept[0]


def test_another_probe_is_refused():
    model = learned()
    other = tt.PointShell.from_spec("sphere:0.02", n_points=300)
    with pytest.raises(MessageError, match="same probe"):
        decode_model(encode_model(model), model.surface, other)

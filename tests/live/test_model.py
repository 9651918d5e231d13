"""What a live model learns from presses, without a link."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ttus_opt.live.feedback import ModelFeedback
from ttus_opt.live.messages import Sample
from ttus_opt.live.model import USUAL_LAW, LiveModel, ModelPlan, _twist
from ttus_opt.live.patient import SimulatedPatient
from ttus_opt.live.subject import example_subject, patient_surface, probe_shell
from ttus_opt.live.tissue import ElasticTorso

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

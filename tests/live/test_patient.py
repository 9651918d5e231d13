"""A recording in the patient's place."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from ttus_opt import example
from ttus_opt.core.errors import InputError
from ttus_opt.live.follower import Follower
from ttus_opt.live.hand import Hand
from ttus_opt.live.impairment import Impairment
from ttus_opt.live.model import USUAL_LAW
from ttus_opt.live.patient import RecordedPatient
from ttus_opt.live.safety import State
from ttus_opt.live.simulation import CLOCKS_APART, Simulation
from ttus_opt.live.subject import MEETING, example_subject
from ttus_opt.live.trial import made_operator, prepared


@pytest.fixture(scope="module")
def press():
    return tt.read_trajectory(example.path("press_fit.csv"))


def test_plays_in_time_once_it_may_begin(press):
    may = [False]
    patient = RecordedPatient(press, lambda: may[0])
    nowhere = np.eye(3), np.full(3, 9.0)  # a target it does not obey
    before = patient.sense(100.0, *nowhere)
    assert before.time == 100.0
    np.testing.assert_array_equal(before.position, press.position[0])
    may[0] = True
    patient.sense(200.0, *nowhere)
    may[0] = False  # asked no more
    k = 123
    found = patient.sense(200.0 + press.time[k] - press.time[0], *nowhere)
    np.testing.assert_array_equal(found.position, press.position[k])
    np.testing.assert_array_equal(found.wrench, [*press.force[k], *press.torque[k]])
    between = patient.sense(200.02 + press.time[k] - press.time[0], *nowhere)
    assert between.time == found.time
    after = patient.sense(1000.0, *nowhere)
    np.testing.assert_array_equal(after.position, press.position[-1])
    assert patient.played == patient.seconds


def test_refuses_what_cannot_teach(press):
    with pytest.raises(InputError, match="force and torque"):
        RecordedPatient(replace(press, torque=None), lambda: True)
    with pytest.raises(InputError, match="one recording"):
        RecordedPatient(tt.Trajectory.concatenate([press, press]), lambda: True)


@pytest.mark.slow
def test_what_is_felt_was_learned_from_the_recording(press):
    who, content = example_subject(), prepared(1.6, USUAL_LAW)
    follower, shell = Follower(3, who.surface, content), who.shell
    safety = follower.peer.safety
    patient = RecordedPatient(press, lambda: safety.state is State.NORMAL)
    operator = made_operator("model", shell)
    hand = Hand(who.examination(), again=MEETING)
    session = Simulation(operator, follower, hand, patient, Impairment(delay=0.5))
    unseen, errors = tt.read_trajectory(example.path("press_test.csv")), {}
    for moment in session.run(23.0):
        assert CLOCKS_APART + moment.time + 1e-9 >= moment.sensed.time
        if operator.model is not None and "prior" not in errors:
            errors["prior"] = tt.evaluate(operator.model.field, shell, unseen).errors
    errors["learned"] = tt.evaluate(operator.model.field, shell, unseen).errors
    assert patient.played == patient.seconds
    assert safety.cause == ""
    assert errors["learned"].force_magnitude_error_N < 0.36
    assert errors["prior"].force_magnitude_error_N > 1.0

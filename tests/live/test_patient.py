"""A recording in the patient's place."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses
from ttus_opt import example
from ttus_opt.live.follower import Follower
from ttus_opt.live.impairment import Impairment
from ttus_opt.live.model import USUAL_LAW
from ttus_opt.live.patient import AHEAD, RecordedPatient, SkinMotion
from ttus_opt.live.safety import State
from ttus_opt.live.simulation import CLOCKS_APART, Simulation
from ttus_opt.live.subject import MEETING, Hand, example_subject
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
    who, content = example_subject(), prepared(2.0, USUAL_LAW)
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


def breath(time):
    return 0.005 * np.sin(2.0 * np.pi * 0.25 * time) * np.array([0.0, 1.0, 0.0])


def test_a_line_is_continued_exactly_and_not_for_ever():
    motion, velocity = SkinMotion(), np.array([0.001, -0.002, 0.003])
    for time in (0.0, 0.03, 0.07):
        motion.see(time, time * velocity)
    np.testing.assert_allclose(motion.at(0.12), 0.12 * velocity, atol=1e-15)
    np.testing.assert_allclose(motion.at(9.0), (0.07 + AHEAD) * velocity, atol=1e-15)
    motion.see(0.05, np.ones(3))  # came too late
    np.testing.assert_allclose(motion.at(0.12), 0.12 * velocity, atol=1e-15)


@pytest.mark.parametrize(("rate", "most"), [(30.0, 1.5e-4), (60.0, 1.1e-4)])
def test_a_breath_is_followed_closer_than_it_is_seen(rate, most):
    """½ a ((age + span / 2)² - span² / 12) is what a line leaves of a breath."""
    motion, errors, late = SkinMotion(), [], []
    for now in np.arange(0.2, 8.0, 0.004):
        image = np.floor((now - 0.05) * rate) / rate
        motion.see(image, breath(image))
        errors.append(np.linalg.norm(motion.at(now) - breath(now)))
        late.append(np.linalg.norm(breath(image) - breath(now)))
    assert max(errors[50:]) < most < 0.4 * max(late)


def test_nothing_seen_is_at_rest_and_one_image_stays():
    motion = SkinMotion()
    assert not motion.at(1.0).any()
    motion.see(1.0, [0.0, 0.004, 0.0])
    np.testing.assert_array_equal(motion.at(1.1), [0.0, 0.004, 0.0])


@pytest.mark.parametrize("bad", [[0.0, np.nan, 0.0], [0.0, 0.0]])
def test_unusable_images(bad):
    refuses(InputError, "three finite numbers", SkinMotion().see, 0.0, bad)

"""Comparators in one simulation: what must hold of each."""

import contextlib
import json
import multiprocessing
import os
import signal
from dataclasses import replace

import numpy as np
import pytest

from tests.kit import InputError, refuses
from tests.live import springy
from ttus_opt.live import demo
from ttus_opt.live.recording import frames_of
from ttus_opt.live.subject import MEETING, ROUND, Hand, example_subject
from ttus_opt.live.trial import COMPARATORS, Trial, run


@pytest.mark.slow
def test_over_a_delay_the_model_is_close_and_passive_and_the_measured_force_is_not():
    """Short sessions with a round trip of 600 ms."""
    names = ("model", "direct")
    model, direct = (run(Trial(n, 0.6, seconds=7.0, settled=5.0)) for n in names)
    assert model.error < 0.5
    assert model.energy < 0.05
    assert model.step < 0.1
    assert model.stopped == ""
    assert model.packets <= 50.0
    assert model.bits <= 64_000.0
    assert direct.energy > 0.3
    assert direct.error > 5 * model.error
    told = json.loads(json.dumps(model.as_dict()))  # plain numbers
    assert told["comparator"] == "model"
    assert told["error_N"] == model.error


@pytest.mark.slow
def test_sessions_at_a_time_are_those_one_by_one(tmp_path):
    trials = [Trial(name, 0.1, seconds=4.0, settled=2.0) for name in COMPARATORS]
    one = demo._all(trials, tmp_path / "one.mcap", 1, print)
    two = demo._all(trials, tmp_path / "two.mcap", 2, print)
    assert [r.as_dict() for r in one] == [r.as_dict() for r in two]
    files = [frames_of(tmp_path / f"{name}.mcap")[1] for name in ("one", "two")]
    assert list(files[0]) == list(files[1])


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs fork")
def test_a_trial_that_is_ended_ends_its_process(monkeypatch):
    """A pool would take its SystemExit for a result and give the process the next."""
    monkeypatch.setattr(demo, "run", lambda _: signal.raise_signal(signal.SIGTERM))
    arguments = Trial("model", 0.1), None
    context = multiprocessing.get_context("fork")
    process = context.Process(target=_then_17, args=(demo._one_of_pool, *arguments))
    process.start()
    process.join()
    assert process.exitcode == 1


def _then_17(call, *arguments):
    with contextlib.suppress(BaseException):
        call(*arguments)
    os._exit(17)


@pytest.mark.slow
def test_without_delay_the_measured_force_is_near_the_truth():
    passive = run(Trial("passive", 0.0, seconds=10.0, settled=8.0))
    assert passive.error < 0.8
    assert passive.energy < 0.05


@pytest.mark.slow
def test_a_model_that_never_learns_keeps_its_error():
    fixed = run(Trial("fixed", 0.0, prior=1.6, seconds=10.0, settled=8.0))
    assert fixed.folded == 0
    assert fixed.error > 0.8


def test_the_hand_begins_and_moves_between_places_lifted():
    path = example_subject().examination()
    speed = np.linalg.norm(path.velocity(), axis=1)
    assert speed[0] < 1e-6
    assert speed.max() < 0.4
    hand = Hand(path, again=MEETING)
    for time in (MEETING + 0.3, ROUND - 1e-4, ROUND + 1.7):
        later = time + 5 * (ROUND - MEETING)
        np.testing.assert_allclose(
            hand.wanted(later)[0], hand.wanted(time)[0], atol=1e-9
        )
    still = Hand(path)  # stays at its end
    np.testing.assert_allclose(still.wanted(99.0)[0], path.position[-1], atol=1e-9)


def test_a_hand_swings_about_where_a_force_meets_its_spring():
    """A damped oscillator of 0.4 kg, 500 N/m and 15 N·s/m under a step of 2 N."""
    force, step = np.array([0.0, 2.0, 0.0, 0.0, 0.0, 0.0]), 1e-4
    hand = Hand(springy.path(depth=0.0))
    times, moved = step * np.arange(1, 2001), []
    for _ in times:
        hand.step(0.0, force, step)
        moved.append(hand.position[1])
    decay, turn = 15.0 / 0.8, np.sqrt(500.0 / 0.4 - (15.0 / 0.8) ** 2)
    swing = np.cos(turn * times) + decay / turn * np.sin(turn * times)
    expected = 2.0 / 500.0 * (1.0 - np.exp(-decay * times) * swing)
    np.testing.assert_allclose(moved, expected, atol=2e-5)


@pytest.mark.parametrize(
    "bad",
    [
        {"comparator": "x"},
        {"prior": 0.0},
        {"loss": 1.0},
        {"round_trip": -1.0},
        {"seed": -1},
    ],
)
def test_unusable_trials(bad):
    refuses(InputError, "", Trial, **bad)


def test_a_long_session_keeps_few_of_its_frames(monkeypatch):
    whole = run(Trial(seconds=1.0))
    monkeypatch.setattr("ttus_opt.live.trial.MOST_KEPT", 20)
    few = run(Trial(seconds=1.0))
    assert 10 <= len(few.time) < 20 < len(whole.time)
    every = [*whole.time].index(few.time[1])
    for one, all_ in ((few.time, whole.time), (few.felt, whole.felt)):
        np.testing.assert_array_equal(one, all_[::every])
    assert (few.largest, few.energy) == (whole.largest, whole.energy)


@pytest.mark.slow
@pytest.mark.parametrize("round_trip", [0.0, 1.0])
def test_the_probe_goes_along_with_the_breath(round_trip):
    trial = Trial("model", round_trip, breathing=0.005, seconds=14.0)
    seen, blind = run(trial), run(replace(trial, camera=False))
    assert seen.error < 0.36
    assert blind.error > 2.0 * seen.error

"""What the hand feels, without a link."""

from dataclasses import replace

import numpy as np
import pytest

from tests.live.springy import BALL, RADIUS, parts
from ttus_opt.live.feedback import PRESLIDING_LENGTH, ModelFeedback
from ttus_opt.live.model import decode_model
from ttus_opt.live.trial import Trial, run
from ttus_opt.message import decode

MU, FRAME = 0.25, 1e-3


def rubbed():
    """Positions and forces of a probe that is rubbed to and fro at constant depth."""
    _, shell, (sent, content) = parts()
    field = decode_model(content, decode(sent), shell).field
    parameters = {**field.parameters, "friction_coefficient": MU}
    feedback = ModelFeedback(replace(field, parameters=parameters), shell)
    time = np.arange(0.0, 3.0, FRAME)
    along = 0.15 + 0.008 * np.sin(2.0 * np.pi * time)
    depth = 0.01 * np.minimum(time / 0.2, 1.0)
    at = np.stack([RADIUS + BALL - depth, np.zeros_like(time), along], axis=1)
    felt = [feedback.felt(t, np.eye(3), p)[:3] for t, p in zip(time, at, strict=True)]
    return at, np.array(felt)


def test_friction_of_a_rubbed_probe_turns_round_without_a_jump():
    at, felt = rubbed()
    at, felt = at[1000:], felt[1000:]  # pressed, and slid once
    normal, across = felt[:, 0], felt[:, 2]
    speed = np.abs(np.diff(at[:, 2])).max() / FRAME
    most = MU * normal.max() * speed * FRAME / PRESLIDING_LENGTH
    assert np.abs(np.diff(across)).max() <= 1.2 * most
    # slid by more than twice the length: Coulomb's
    fast = np.abs(np.gradient(at[:, 2], FRAME)) > 0.97 * speed
    assert np.abs(across[fast]) == pytest.approx(MU * normal[fast], rel=0.05)
    moved = np.gradient(at[:, 2], FRAME)[fast]
    assert (across[fast] * moved < 0.0).all()


def test_friction_gives_no_energy():
    at, felt = rubbed()
    work = np.cumsum(0.5 * (felt[1:] + felt[:-1])[:, 2] * np.diff(at[:, 2]))
    stored = 0.5 * MU * felt[:, 0].max() * PRESLIDING_LENGTH
    gained = (work - np.minimum.accumulate(work)).max()
    assert gained <= 1.1 * stored
    # area of a Prandtl stop's loop, in each of the last two turns
    loop = 4.0 * MU * felt[1000:, 0].mean() * (0.008 - PRESLIDING_LENGTH)
    assert work[999] - work[-1] == pytest.approx(2.0 * loop, rel=0.01)


@pytest.mark.slow
def test_friction_over_a_delay_meets_the_goals():
    trial = Trial(round_trip=1.0, friction=MU, prior=1.6, seconds=20.0)
    result = run(trial)
    assert 0.75 * MU < result.friction < 1.05 * MU
    assert result.stopped == ""
    assert result.error <= 0.36
    assert result.energy <= 0.05
    assert result.step <= 0.05

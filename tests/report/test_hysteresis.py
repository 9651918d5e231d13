"""A spring gives back all of its work, with friction or damping less of it."""

import numpy as np
import pytest

from ttus_opt.core.errors import InputError
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.hysteresis import hysteresis_share

SHELL = PointShell.from_spec("sphere:0.01")
STIFFNESS = 800.0
TIME = np.arange(200) / 20.0
DEPTH = 0.008 * np.sin(2.0 * np.pi * TIME / 5.0)  # two presses, lifted in between


def presses(lost=0.0, depth=DEPTH):
    """A spring along y, weaker by a share on the way out."""
    touching = np.maximum(depth, 0.0)
    leaving = np.gradient(depth) < 0.0
    size = STIFFNESS * touching * np.where(leaving, 1.0 - lost, 1.0)
    force = np.outer(size, [0.0, 1.0, 0.0])
    position = np.outer(-depth, [0.0, 1.0, 0.0])
    n = len(depth)
    return Trajectory(TIME[:n], position, np.tile(np.eye(3), (n, 1, 1)), force)


def test_a_spring_gives_everything_back():
    assert hysteresis_share(presses(), SHELL, 0.5) == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize("lost", [0.1, 0.4])
def test_share_is_what_is_missing_on_the_way_out(lost):
    found = hysteresis_share(presses(lost), SHELL, 0.5)
    assert found == pytest.approx(lost, abs=0.03)


def test_a_turn_against_a_torque_is_work_too():
    recording = presses()
    angle = 0.3 * np.sin(2.0 * np.pi * TIME / 5.0)
    cos, sin, no = np.cos(angle), np.sin(angle), np.zeros_like(angle)
    rotation = np.stack([cos, -sin, no, sin, cos, no, no, no, no + 1.0], axis=1)
    rate = np.gradient(angle, TIME)
    torque = np.outer(-0.05 * rate, [0.0, 0.0, 1.0])  # a damper alone
    turned = Trajectory(
        TIME,
        np.zeros((len(TIME), 3)),
        rotation.reshape(-1, 3, 3),
        recording.force,
        torque,
    )
    assert hysteresis_share(turned, SHELL, 0.5) == pytest.approx(1.0, abs=1e-6)


def test_nothing_is_told_where_no_press_is_complete():
    middle = presses(0.4).select(slice(10, 40))
    assert np.isnan(hysteresis_share(middle, SHELL, 0.5))
    bare = Trajectory(middle.time, middle.position, middle.rotation)
    with pytest.raises(InputError, match="forces"):
        hysteresis_share(bare, SHELL, 0.5)

"""The table of docs/how-to/live.md, line by line."""

import numpy as np
import pytest

from tests.kit import InputError, refuses
from ttus_opt.live.safety import SafetyLimits, State, Supervisor

NORMAL, HOLD, STOP = State.NORMAL, State.HOLD, State.STOP


def running(now=0.0):
    one = Supervisor()
    one.heard(now, NORMAL, 0)
    assert one.judge(now) is NORMAL
    assert one.cause == ""
    return one


def test_before_the_other_side_is_met_it_holds_however_long():
    one = Supervisor()
    assert one.judge(0.0) is HOLD
    assert one.judge(100.0) is HOLD


def test_silence_holds_then_stops():
    one = running()
    assert one.judge(0.099) is NORMAL
    assert one.judge(0.1) is HOLD
    assert one.judge(0.499) is HOLD
    assert one.judge(0.5) is STOP
    assert "500 ms" in one.cause


def test_packets_end_a_hold():
    one = running()
    assert one.judge(0.3) is HOLD
    one.heard(0.31, NORMAL, 0)
    assert one.judge(0.31) is NORMAL


def test_three_periods_if_they_are_longer():
    assert SafetyLimits(period=0.05).silence == pytest.approx(0.15)
    refuses(InputError, "stop_seconds", SafetyLimits, period=0.2)


def test_what_is_missing_holds():
    one = running()
    assert one.judge(0.01, "no model") is HOLD
    assert one.cause == "no model"


@pytest.mark.parametrize(
    ("force", "torque"), [(41.0, 0.0), (0.0, 4.1), (np.nan, 0.0), (0.0, np.inf)]
)
def test_limits_and_nan_stop(force, torque):
    one = running()
    one.check_wrench(force, torque)
    assert one.state is STOP


def test_a_flood_of_damage_stops_and_a_trickle_does_not():
    one = running()
    for k in range(100):
        one.heard(0.1 * k, NORMAL, 0)
        one.damaged(0.1 * k)
        assert one.judge(0.1 * k) is NORMAL
    for k in range(20):
        one.damaged(10.0 + 0.01 * k)
    assert one.state is STOP


def test_stop_latches_and_keeps_its_first_cause():
    one = running()
    one.stop("the button")
    one.stop("something else")
    one.heard(0.01, NORMAL, 0)
    assert one.judge(0.01) is STOP
    assert (one.cause, one.stops) == ("the button", 1)


def test_the_other_sides_stop_stops():
    one = running()
    one.heard(0.01, STOP, 1)
    assert one.judge(0.01) is STOP


def test_rearming_needs_zero_contact_and_holds_until_both_are():
    one, other = running(), running()
    one.stop("the button")
    other.heard(0.1, one.state, one.stops)
    refuses(InputError, "zero contact", one.rearm, 0.5)
    refuses(InputError, "zero contact", one.rearm, np.nan)
    one.rearm(0.0)
    one.heard(0.3, other.state, other.stops)  # it stopped because of this side
    assert one.judge(0.3) is HOLD
    other.rearm(0.0)
    other.heard(0.4, one.state, one.stops)
    one.heard(0.4, other.state, other.stops)
    assert other.judge(0.4) is NORMAL
    assert one.judge(0.4) is NORMAL


def test_nothing_to_rearm():
    refuses(InputError, "has not stopped", running().rearm, 0.0)


def test_who_joins_a_stopped_side_holds():
    one = Supervisor()
    one.heard(0.0, STOP, 3)
    assert one.judge(0.0) is HOLD
    one.heard(0.1, NORMAL, 3)
    assert one.judge(0.1) is NORMAL


def test_unusable_limits():
    refuses(InputError, "force must be positive", SafetyLimits, force=-1.0)

"""One step of a swap between wrenches given by hand: rates, tank, trapezoid, air."""

import numpy as np
import pytest

from ttus_opt.haptic import blend

NO_DRAG = np.zeros(6), np.zeros(6)


def stepped(
    current,
    target,
    *,
    contact=5,
    gap=0.0,
    tank=0.0,
    last=None,
    motion=None,
    law=None,
    drags=NO_DRAG,
):
    """The ledger after one step of a swap, between wrenches given by hand."""
    limits = (law or blend.BlendLaw(force_rate=1e3)).kernel_limits(0.02)
    ledger, origin = blend.settled_ledger(tank), np.zeros(3)
    blend.follow(ledger, np.eye(3), origin, origin)
    ledger[blend.PROGRESS], ledger[blend.GAP] = 0.0, gap
    ledger[blend.DIFFERENCE : blend.BENT] = target - current if last is None else last
    at = origin if motion is None else motion
    moved = blend.follow(ledger, np.eye(3), at, origin)
    blend.advance(ledger, limits, contact, moved, current, target, *drags)
    return ledger


NOTHING, PUSH = np.zeros(6), np.array([3.0, 0.0, 4.0, 0.0, 0.0, 0.0])
TWISTING = np.array([0.0, 0.0, 0.0, 0.0, 0.06, 0.08])  # a tenth of 1 N·m


def test_a_step_keeps_to_the_rates_of_force_and_of_torque():
    law = blend.BlendLaw(force_rate=2.0)
    assert stepped(NOTHING, PUSH, law=law)[blend.PROGRESS] == pytest.approx(2e-3 / 5.0)
    turned = stepped(NOTHING, TWISTING, law=law)[blend.PROGRESS]
    assert turned == pytest.approx(2e-3 * 0.02 / 0.1)


def test_the_rates_are_of_contact_and_drag_together():
    law, drags = blend.BlendLaw(force_rate=2.0), (0.5 * PUSH, -0.25 * PUSH)
    step = stepped(NOTHING, PUSH, law=law, drags=drags)[blend.PROGRESS]
    assert step == pytest.approx(2e-3 / (0.25 * 5.0))
    drags = (NOTHING, TWISTING)
    step = stepped(NOTHING, NOTHING, law=law, drags=drags)[blend.PROGRESS]
    assert step == pytest.approx(2e-3 * 0.02 / 0.1)


def test_the_tank_holds_no_more_than_its_capacity():
    law = blend.BlendLaw(force_rate=1e6, capacity=0.01)
    ledger = stepped(NOTHING, NOTHING, gap=-0.5, tank=0.004, law=law)
    assert ledger[blend.PROGRESS] == 1.0
    assert ledger[blend.TANK] == 0.01
    assert ledger[blend.INJECTED] == -0.5


def test_stored_energy_falls_by_the_trapezoid():
    """Half of the last difference and half of this one, along the way; not of drag."""
    motion, last = np.array([1e-3, 0.0, 2e-3]), np.array([1.0, 0, 2.0, 0, 0, 0])
    ledger = stepped(
        NOTHING, PUSH, gap=0.3, last=last, motion=motion, drags=(NOTHING, 9 * PUSH)
    )
    work = 0.5 * (last[:3] + PUSH[:3]) @ motion
    assert ledger[blend.GAP] == pytest.approx(0.3 - work, rel=1e-12)
    np.testing.assert_array_equal(ledger[blend.DIFFERENCE : blend.BENT], PUSH)


def test_in_the_air_nothing_is_stored():
    """Whatever had been observed: the swap is complete in one frame, for nothing."""
    ledger = stepped(NOTHING, NOTHING, contact=0, gap=0.3, last=PUSH)
    assert ledger[blend.GAP] == 0.0
    assert ledger[blend.PROGRESS] == 1.0
    assert ledger[blend.INJECTED] == 0.0

"""A live session in a page, without a browser: the hand, the link, the button."""

import time
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("viser", reason="needs ttus-opt[viewer]")
pytest.importorskip("msgspec", reason="needs ttus-opt[live]")

from tests.kit import InputError, refuses
from tests.viewer.test_viewer import until
from ttus_opt.live.trial import Trial
from ttus_opt.viewer.live_page import LivePage
from ttus_opt.viewer.live_session import LiveSession
from ttus_opt.viewer.live_tab import numbers


def run(session, seconds):
    """Frames without waiting for the clock on the wall."""
    for k, _ in enumerate(session._session.run(seconds)):
        if k % 20 == 0:
            session._remember()


@pytest.mark.slow
def test_a_session_without_a_page():
    session = LiveSession(Trial(round_trip=0.0, prior=1.6))
    run(session, 3.0)
    assert session.learned > 5
    assert "NORMAL" in numbers(session.view())
    time, measured, felt = np.array(session.samples).T
    assert (np.diff(time) > 0).all()
    assert measured.max() > 2.0
    assert abs(felt - measured)[-20:].mean() < 1.0

    session.worsen(round_trip=0.4)
    run(session, 1.2)
    assert session.view().round_trip == pytest.approx(0.4, abs=0.1)

    session.stop()
    run(session, 0.6)
    assert "STOP: the operator" in numbers(session.view())
    assert not np.any(session.view().force)
    lifted = session.hand.position + np.array([0.0, 0.05, 0.0])
    session.hand.lead = session.hand.rotation, lifted
    run(session, 1.2)
    np.testing.assert_allclose(session.hand.position, lifted, atol=1e-3)
    session._measured[:] = 1.0  # one side has contact: the other is armed already
    refuses(InputError, "at zero contact only", session.rearm)
    run(session, 1.0)
    session.rearm()
    run(session, 1.0)
    assert session.view().state == "NORMAL"
    refuses(InputError, "nothing to re-arm", session.rearm)


def test_a_link_that_brings_no_model():
    refuses(InputError, "no model arrived", LiveSession, Trial(round_trip=20.0))


@pytest.fixture(scope="module")
def page():
    with LivePage(port=0) as opened:
        yield opened


@pytest.mark.slow
def test_the_page_follows_the_hand_until_somebody_drags(page):
    state = page.viewer.state
    assert page.tab.presses.value
    before = page.session.view().time
    until(lambda: page.session.view().time > before + 0.1)
    assert state.source == "outside"
    state.press(-0.01)  # a drag
    until(lambda: not page.tab.presses.value)
    wanted = state.pose[1]
    until(lambda: np.linalg.norm(page.session.hand.position - wanted) < 0.002)
    page.tab.presses.value = True
    page.tab._release(True)
    until(lambda: state.source == "outside")
    assert page.session.hand.lead is None


@pytest.mark.slow
def test_one_click_takes_the_probe_over_whenever_it_comes(page):
    state = page.viewer.state
    page.tab.presses.value = True
    page.tab._release(True)
    until(lambda: state.source == "outside")
    with state.lock:
        time.sleep(0.3)  # a batch ends meanwhile, and waits to move the probe
        state.press(-0.02)
        wanted = state.pose[1]
    until(lambda: np.linalg.norm(page.session.hand.position - wanted) < 0.002, 10.0)
    page.tab.presses.value = True  # a visitor's tick, before the page acts on it
    before = page.session.view().time
    until(lambda: page.session.view().time > before + 0.1)
    assert page.tab.presses.value


@pytest.mark.slow
def test_a_session_that_cannot_begin_again_is_told(page, monkeypatch):
    told, trial = [], page.session.trial
    monkeypatch.setattr(page.viewer.page, "tell", told.append)
    page.session.trial = replace(trial, round_trip=20.0)
    for pressed in page.tab.again._impl.update_cb:
        pressed(None)
    page.session.trial = trial
    assert told == ["no model arrived within 5 s: the link is too bad"]

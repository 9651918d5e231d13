"""Stiffness and friction of the recordings are found, sent and rendered."""

import numpy as np
import pytest

from tests.comparators.contacts import NO_PATCH, STILL, made
from tests.comparators.recordings import facing, fitted, recordings
from tests.kit import InputError, refuses, torso
from ttus_opt.comparators.patch_law import RecursiveLeastSquares
from ttus_opt.comparators.patch_model import Contact, Sample
from ttus_opt.comparators.perceptual_updates import PerceptualUpdates


def test_friction_and_stiffness_of_the_recordings_are_sent():
    law = fitted("perceptual_updates")
    sent = law.parameters()
    assert 0.0 < sent["share"] < 0.6
    slide = recordings()[1]
    place = law.samples(slide, slide.force)[10].contact.place
    # 900 · 10 · (5 mm)^1.5 N at 5 mm, and the drag they were made with
    stiffness, friction = law.model_at(place)
    assert stiffness == pytest.approx(9000.0 * 0.005**1.5 / 0.5, rel=0.25)
    assert friction == pytest.approx(0.2, abs=0.05)


def test_a_finer_difference_sends_more():
    counts = []
    for jnd in (0.0, 0.1, 0.5):
        law = made(PerceptualUpdates, stiffness_jnd=jnd)
        law.fit(recordings())
        counts.append(len(law.updates))
    assert counts[0] > counts[1] > counts[2] >= 1
    assert counts[0] <= law.samples_seen


def test_an_update_is_sent_exactly_when_the_difference_is_noticeable():
    law = made(PerceptualUpdates)
    place, still = np.array([0.1, 0.0, 0.1]), RecursiveLeastSquares.start
    for stiffness, friction, sent in ((5.0, 0.0, 1), (5.49, 0.04, 1), (5.51, 0.0, 2)):
        law._send(
            place,
            still(np.array([stiffness]), np.ones(1), 1.0),
            still(np.array([friction]), np.ones(1), 1.0),
        )
        assert len(law.updates) == sent


def test_between_two_places_the_nearer_one_counts():
    law = made(PerceptualUpdates)
    start = RecursiveLeastSquares.start
    places = np.array([[0.1, 0.0, 0.1], [0.1, 0.0, 0.12]])
    for place, stiffness in zip(places, (4.0, 8.0), strict=True):
        law._send(
            place,
            start(np.array([stiffness]), np.ones(1), 1.0),
            start(np.array([0.0]), np.ones(1), 1.0),
        )
    for place, stiffness in zip(places, (4.0, 8.0), strict=True):
        assert law.model_at(place)[0] == pytest.approx(stiffness, rel=1e-2)
    assert law.model_at(places.mean(axis=0))[0] == pytest.approx(6.0)
    nearer = law.model_at(0.6 * places[0] + 0.4 * places[1])[0]
    assert 4.0 < nearer < 5.5


def test_of_a_single_frame_all_is_sent():
    law = made(PerceptualUpdates)
    assert law.parameters() == {"updates sent": 0.0, "share": 0.0}
    contact = Contact(1.0, 0.0, np.array([0.1, 0.0, 0.1]), STILL, NO_PATCH)
    law._fit_law([Sample(contact, 5.0, STILL)])
    assert law.parameters() == {"updates sent": 1.0, "share": 1.0}


def test_rendered_drag_is_against_the_motion_and_in_proportion():
    law = fitted("perceptual_updates")
    R, at = facing(torso(), 1.3, 0.1, 0.005)
    along = np.array([0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    rest, there, back = (law.render(R, at, v) for v in (None, along, -along))
    drag = there.force - rest.force
    np.testing.assert_allclose(drag, -(back.force - rest.force), atol=1e-3)
    share = -drag[2] / np.linalg.norm(rest.force)
    assert share == pytest.approx(0.2, abs=0.05)
    # it acts at the contact, on the probe's surface
    turned = there.torque - rest.torque
    arm = law.geometry.touch(R, at).patch.arm
    assert np.linalg.norm(arm) == pytest.approx(0.0135, abs=0.001)
    np.testing.assert_allclose(turned, np.cross(arm, drag), atol=1e-9)


def test_a_jnd_that_makes_no_sense_is_told():
    refuses(InputError, "stiffness_jnd", made, PerceptualUpdates, stiffness_jnd=-0.1)

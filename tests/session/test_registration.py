"""How the frames of a session lie, by the motions between them."""

import json

import numpy as np

from tests.kit import InputError, refuses
from tests.session.recordings import copied
from ttus_opt.core.saved_results import plain
from ttus_opt.phantom.example_data import true_surface
from ttus_opt.session.description import read_description
from ttus_opt.session.registration import Registration, register
from ttus_opt.session.synthetic import Truth

TRUTH = Truth()


def test_each_frame_has_its_own_way_to_the_patient():
    tracker_to_scan, scan_to_patient = TRUTH.tracker_to_scan, TRUTH.tag_to_target
    frames = Registration(tracker_to_scan, scan_to_patient, None)
    assert frames.to_patient("patient") == []
    (alone,) = frames.to_patient("scan")
    np.testing.assert_array_equal(alone, scan_to_patient)
    first, second = frames.to_patient("tracker")
    np.testing.assert_array_equal(first, tracker_to_scan)
    np.testing.assert_array_equal(second, scan_to_patient)
    unknown = Registration(None, scan_to_patient, None)
    assert unknown.to_patient("patient") == []
    refuses(InputError, "frame tracker is unknown here", unknown.to_patient, "tracker")


def test_facts_are_what_was_found_and_nothing_else(tmp_path):
    session = read_description(copied(tmp_path))
    frames = register(session.tracker, true_surface())
    told = json.loads(json.dumps(plain(frames.facts())))
    found = np.array(told["tracker_to_scan"])
    np.testing.assert_allclose(found, TRUTH.tracker_to_scan, atol=2e-3)
    place = true_surface().axis.scan_to_patient
    np.testing.assert_array_equal(told["scan_to_patient"], place)
    assert told["pairs"] == 60
    # the noise of one pair of poses, and less
    assert told["loop_m"] < 2e-3 and told["loop_degrees"] < 0.3
    stated = json.loads(json.dumps(plain(Registration(None, place, None).facts())))
    assert stated == {"tracker_to_scan": None, "scan_to_patient": place.tolist()}

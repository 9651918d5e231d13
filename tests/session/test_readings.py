"""Clock and contact wrenches, against the truth."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses
from tests.session.recordings import changed
from tests.session.single_steps import SURFACE, forces, streams
from ttus_opt.sensors.streams import WrenchStream, with_wrenches
from ttus_opt.session.description import Part, read_description
from ttus_opt.session.readings import contact_wrenches, cut, synchronise
from ttus_opt.session.registration import probe_poses, register
from ttus_opt.session.synthetic import Truth, perfect


def offset(session, later):
    """Of raw readings whose clock shows so much more [s]."""
    frames = register(session.tracker, SURFACE)
    poses, wrenches = probe_poses(session.tracker, frames), forces(session)
    wrenches = replace(wrenches, time=wrenches.time + later)
    return synchronise(session, poses, wrenches, SURFACE, frames).offset


@pytest.mark.slow
def test_offsets_of_raw_readings_are_found_as_far_as_is_looked(recording):
    """About zero, or where clocks of other epochs would begin together."""
    truth = Truth().offset
    changed(recording, "clock", {"by": "gravity", "largest_offset": 1.5})
    session = read_description(recording)
    assert offset(session, 2.0) == pytest.approx(truth - 2.0, abs=0.002)
    changed(recording, "clock.together", True)
    session = read_description(recording)
    # the sensor's first reading is `truth` behind its clock's zero
    assert offset(session, 1e6) == pytest.approx(truth - 1e6, abs=0.002)
    # nothing within reach goes with the weight: a chance likeness is not believed
    changed(recording, "clock", {"by": "gravity", "largest_offset": 0.2})
    with pytest.raises(InputError, match="forces in free air follow the tilts"):
        offset(read_description(recording), 0.0)


@pytest.mark.parametrize("frame", ["probe", "patient", "scan", "tracker"])
def test_contact_wrenches_of_a_frame_are_turned_to_the_patient(recording, frame):
    """Of a perfect sensor, whose clock is found by contact."""
    own = perfect(5.0)["press_fit"]
    for key in ("free", "clock", "force"):
        changed(recording, key, None)
    changed(recording, "force", {"file": "force.nc", "frame": frame})
    session = read_description(recording)
    frames = register(session.tracker, SURFACE)
    turn = np.eye(3)
    for motion in () if frame == "probe" else frames.to_patient(frame):
        turn = motion[:3, :3] @ turn
    turns = own.rotation if frame == "probe" else np.tile(turn, (len(own), 1, 1))
    force, torque = (
        np.einsum("tji,tj->ti", turns, values) for values in (own.force, own.torque)
    )
    wrenches = WrenchStream(own.time - 0.35, force, torque)
    poses = replace(own, force=None, torque=None)
    timing = synchronise(session, poses, wrenches, SURFACE, frames)
    assert timing.offset == pytest.approx(0.35, abs=0.02)
    assert set(timing.second.values) == {0.0, 1.0}
    joined = with_wrenches(poses, wrenches, 0.35, largest_gap=0.1)
    shell = tt.PointShell.from_spec(session.probe, n_points=120)
    found, load = contact_wrenches(session, joined, shell, frames, 0.0)
    assert load is None and found.force is not None and found.torque is not None
    at = np.searchsorted(own.time, found.time)
    np.testing.assert_allclose(found.force, own.force[at], atol=1e-6)
    np.testing.assert_allclose(found.torque, own.torque[at], atol=1e-8)


@pytest.mark.slow
def test_poses_clock_and_load(recording):
    """Against the truth, on the true surface: nothing but noise is left."""
    session, truth = read_description(recording), Truth()
    frames, poses, wrenches = streams(session)
    timing = synchronise(session, poses, wrenches, SURFACE, frames)
    assert timing.offset == pytest.approx(truth.offset, abs=0.002)
    joined = with_wrenches(poses, wrenches, timing.offset, largest_gap=0.1)
    shell = tt.PointShell.from_spec(session.probe)
    begin = float(poses.time[0])
    contact, load = contact_wrenches(session, joined, shell, frames, begin)
    assert load.mass == pytest.approx(truth.mass, abs=0.001)
    found = cut(contact, session.recordings, begin)
    for part in session.recordings:
        own, seen = perfect(5.0)[part.name], found[part.name]
        at = own.time + part.start
        for values, true, most in (
            (seen.position, own.position, 1e-3),
            (seen.force, own.force, 0.1),
        ):
            again = [np.interp(at, seen.time, column) for column in values.T]
            assert np.abs(np.array(again).T[5:-5] - true[5:-5]).mean() < most


def test_contact_wrenches_of_another_frame(recording):
    """Readings that were compensated before, probe axes: turned, and by contact."""
    session = read_description(recording)
    frames, poses, _ = streams(session)
    own = perfect(5.0)["press_fit"]
    assert own.torque is not None
    force = np.einsum("tji,tj->ti", own.rotation, own.force)
    WrenchStream(own.time + 1.0, force, 0 * force).save(recording / "contact.csv")
    for key in ("free", "clock", "force"):
        changed(recording, key, None)
    changed(recording, "force", {"file": "contact.csv", "frame": "probe"})
    changed(recording, "clock", {"offset": 22.0})
    changed(recording, "tracker.columns", {"position": ["px", "py", "pz"]})
    session = read_description(recording)
    wrenches = forces(session)
    timing = synchronise(session, poses, wrenches, SURFACE, frames)
    joined = with_wrenches(poses, wrenches, timing.offset, largest_gap=0.1)
    shell = tt.PointShell.from_spec(session.probe, n_points=120)
    contact, load = contact_wrenches(session, joined, shell, frames, 0.0)
    assert load is None
    again = [np.interp(contact.time, own.time + 23.0, c) for c in own.force.T]
    assert np.abs(contact.force - np.array(again).T).mean() < 0.03


def test_stretches():
    time = np.arange(0.0, 10.0, 0.1) + 500.0
    turns = np.tile(np.eye(3), (100, 1, 1))
    whole = tt.Trajectory(time, np.zeros((100, 3)), turns)
    first, second = Part("a", 1.0, 3.0), Part("b", 3.0, 9.0, fitted=False)
    found = cut(whole, [first, second], 500.0)
    assert found["a"].time[0] == pytest.approx(501.0)
    assert len(found["b"]) == pytest.approx(60, abs=1)
    refuses(InputError, "a has 0 frames from 1 to 3 s", cut, whole, [first], 0.0)
    with pytest.raises(InputError, match="overlap"):
        cut(whole, [first, Part("b", 2.0, 9.0, fitted=False)], 500.0)

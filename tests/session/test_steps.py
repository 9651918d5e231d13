"""Single steps of a session that need no field."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.session.recordings import changed, copied
from ttus_opt.errors import InputError
from ttus_opt.phantom.example_data import frame, true_surface
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.depth_files import read_depth
from ttus_opt.sensors.intrinsics import read_intrinsics
from ttus_opt.sensors.streams import WrenchStream
from ttus_opt.sensors.unprojection import Unprojection
from ttus_opt.session.description import Description, Part, read_description
from ttus_opt.session.readings import (
    contact_wrenches,
    joined_streams,
    read_forces,
    synchronise,
)
from ttus_opt.session.recordings import cut
from ttus_opt.session.registration import Registration, probe_poses, register
from ttus_opt.session.skin import find_skin
from ttus_opt.session.synthetic import Truth, perfect

SURFACE = true_surface()


@pytest.fixture
def recording(tmp_path: Path) -> Path:
    return copied(tmp_path)


def streams(
    session: Description,
) -> tuple[Registration, Trajectory, WrenchStream]:
    frames = register(session.tracker, SURFACE)
    return frames, probe_poses(session.tracker, frames), read_forces(session)


def test_poses_clock_and_load(recording: Path) -> None:
    """Against the truth, on the true surface: nothing but noise is left."""
    session, truth = read_description(recording), Truth()
    frames, poses, wrenches = streams(session)
    timing = synchronise(session, poses, wrenches, SURFACE, frames)
    assert timing.offset == pytest.approx(truth.offset, abs=0.002)
    joined = joined_streams(session, poses, wrenches, timing)
    shell = PointShell.from_spec(session.probe)
    begin = float(poses.time[0])
    contact, load = contact_wrenches(session, joined, shell, frames, begin)
    assert load is not None
    assert load.mass == pytest.approx(truth.mass, abs=0.001)
    found = cut(contact, session.recordings, begin)
    for part in session.recordings:
        own, seen = perfect(5.0)[part.name], found[part.name]
        assert own.force is not None
        assert seen.force is not None
        at = own.time + part.start
        for values, true, most in (
            (seen.position, own.position, 1e-3),
            (seen.force, own.force, 0.1),
        ):
            again = [np.interp(at, seen.time, column) for column in values.T]
            assert np.abs(np.array(again).T[5:-5] - true[5:-5]).mean() < most


def test_contact_wrenches_of_another_frame(recording: Path) -> None:
    """Readings that were compensated before, probe axes: turned, and by contact."""
    session = read_description(recording)
    frames, poses, _ = streams(session)
    own = perfect(5.0)["press_fit"]
    assert own.force is not None
    assert own.torque is not None
    force = np.einsum("tji,tj->ti", own.rotation, own.force)
    WrenchStream(own.time + 1.0, force, 0 * force).save(recording / "contact.csv")
    for key in ("free", "clock", "force"):
        changed(recording, key, None)
    changed(recording, "force", {"file": "contact.csv", "frame": "probe"})
    changed(recording, "clock", {"offset": 22.0})
    changed(recording, "tracker.columns", {"position": ["px", "py", "pz"]})
    session = read_description(recording)
    timing = synchronise(session, poses, read_forces(session), SURFACE, frames)
    joined = joined_streams(session, poses, read_forces(session), timing)
    shell = PointShell.from_spec(session.probe)
    contact, load = contact_wrenches(session, joined, shell, frames, 0.0)
    assert load is None
    assert contact.force is not None
    again = [np.interp(contact.time, own.time + 23.0, c) for c in own.force.T]
    assert np.abs(contact.force - np.array(again).T).mean() < 0.03


def test_a_stated_frame_and_a_table_of_rays(recording: Path) -> None:
    """A probe held above the sternum: its frame; rays instead of intrinsics."""
    pytest.importorskip("cv2")
    changed(recording, "scan.nodes", [48, 12])
    by_camera = find_skin(read_description(recording).scan)
    own = frame()
    # z into the patient, y to the feet
    held = own.rotation @ np.array([[-1.0, 0, 0], [0, 0, -1], [0, -1, 0]])
    at = own.to_scan(np.array([[0.02, 0.27, 0.15]]))
    time = np.arange(3.0)
    poses = Trajectory(time, np.tile(at, (3, 1)), np.tile(held, (3, 1, 1)))
    poses.save(recording / "sternum.csv", digits=9)
    shape = read_depth(recording / "depth_0.png").shape
    camera = read_intrinsics(recording / "camera.json")
    rays = Unprojection.from_intrinsics(camera, (shape[0], shape[1])).rays
    np.save(recording / "rays.npy", rays)
    changed(recording, "scan.intrinsics", None)
    changed(recording, "scan.rays", "rays.npy")
    changed(recording, "scan.axis_from", "sternum.csv")
    found = find_skin(read_description(recording).scan)
    assert found.cloud is not None
    assert by_camera.cloud is not None
    np.testing.assert_allclose(found.cloud, by_camera.cloud, atol=1e-9)
    np.testing.assert_allclose(found.surface.axis.rotation, own.rotation, atol=1e-6)
    place = own.to_patient(found.surface.axis.origin[None])[0]
    np.testing.assert_allclose(place[[0, 2]], [0.02, 0.15], atol=1e-6)
    assert not np.allclose(by_camera.surface.axis.origin, found.surface.axis.origin)
    # the frame of another surface, and a depth of one's own
    found.surface.save(recording / "earlier.nc")
    changed(recording, "scan.axis_from", "earlier.nc")
    again = find_skin(read_description(recording).scan).surface.axis
    np.testing.assert_allclose(again.origin, found.surface.axis.origin, atol=1e-9)
    changed(recording, "scan.axis_from", "sternum.csv")
    changed(recording, "scan.axis_depth", 0.05)
    skin = find_skin(read_description(recording).scan).surface
    top = skin.radius[np.argmin(np.abs(skin.theta - np.pi / 2)), skin.observed.any(0)]
    assert np.abs(top - 0.05).min() < 0.01


def test_stretches() -> None:
    time = np.arange(0.0, 10.0, 0.1) + 500.0
    turns = np.tile(np.eye(3), (100, 1, 1))
    whole = Trajectory(time, np.zeros((100, 3)), turns)
    first, second = Part("a", 1.0, 3.0), Part("b", 3.0, 9.0, fitted=False)
    found = cut(whole, [first, second], 500.0)
    assert found["a"].time[0] == pytest.approx(501.0)
    assert len(found["b"]) == pytest.approx(60, abs=1)
    with pytest.raises(InputError, match="a has 0 frames from 1 to 3 s"):
        cut(whole, [first], 0.0)
    with pytest.raises(InputError, match="overlap"):
        cut(whole, [first, Part("b", 2.0, 9.0, fitted=False)], 500.0)

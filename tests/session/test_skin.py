"""The surface by a stated frame, and from a table of rays."""

import numpy as np
import pytest

from tests.session.recordings import changed
from ttus_opt.phantom.example_data import frame
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.depth_files import read_depth
from ttus_opt.sensors.intrinsics import read_intrinsics
from ttus_opt.sensors.unprojection import Unprojection
from ttus_opt.session.description import read_description
from ttus_opt.session.skin import find_skin


def test_a_stated_frame_and_a_table_of_rays(recording):
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
    shape = read_depth(recording / "depth_0.png")[0].shape
    camera = read_intrinsics(recording / "camera.json")
    rays = Unprojection.from_intrinsics(camera, (shape[0], shape[1])).rays
    np.save(recording / "rays.npy", rays)
    changed(recording, "scan.intrinsics", None)
    changed(recording, "scan.rays", "rays.npy")
    changed(recording, "scan.axis_from", "sternum.csv")
    found = find_skin(read_description(recording).scan)
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

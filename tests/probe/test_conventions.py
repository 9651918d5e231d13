"""Recordings written otherwise are read as what they are."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import InputError, presses, refuses, torso
from ttus_opt.probe.conventions import Conventions
from ttus_opt.probe.trajectory import Trajectory

CENTROID = np.array([0.01, -0.02, 0.06])
OWN = presses(torso(), 12, np.random.default_rng(5))


def same(a, b):
    for name in ("rotation", "position", "force", "torque"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12)


def test_the_packages_own():
    same(Conventions().read(OWN, CENTROID), OWN)


def test_a_quaternion_written_x_first():
    q = OWN.quat_wxyz
    # a reader of w, x, y, z takes x for w, y for x, z for y and w for z
    misread = Rotation.from_quat(q[:, [1, 2, 3, 0]], scalar_first=True).as_matrix()
    written = replace(OWN, rotation=misread)
    same(Conventions(quaternion="xyzw").read(written, CENTROID), OWN)


def test_a_wrench_in_the_tools_axes_of_the_probe_on_the_patient():
    turn = OWN.rotation.transpose(0, 2, 1)
    written = replace(
        OWN,
        force=-(turn @ OWN.force[..., None])[..., 0],
        torque=-1e3 * (turn @ OWN.torque[..., None])[..., 0],
    )
    told = Conventions(wrench_frame="tool", flip_wrench=True, torque_unit="Nmm")
    same(told.read(written, CENTROID), OWN)


def test_torques_about_another_point():
    """The moment of f at the centroid about the origin is added: τ_o = τ_c + r × f."""
    r = OWN.rotation @ CENTROID
    written = replace(OWN, torque=OWN.torque + np.cross(r, OWN.force))
    told = Conventions(torque_about="origin")
    same(told.read(written, CENTROID), OWN)
    same(told.as_recorded(OWN, CENTROID), written)
    point = Conventions(torque_about=(0.01, -0.02, 0.06))
    same(point.read(OWN, CENTROID), OWN)


def test_wrenches_that_lag():
    """A force that grows linearly is known between frames, too."""
    ramp = np.outer(OWN.time, [1.0, 2.0, 3.0])
    late = replace(OWN, force=ramp - 0.08 * np.array([1.0, 2.0, 3.0]))
    read = Conventions(wrench_delay=0.08).read(late, CENTROID)
    np.testing.assert_allclose(read.force[:-2], ramp[:-2], atol=1e-12)


def test_recordings_are_not_mixed_by_a_lag():
    both = Trajectory.concatenate([OWN, OWN])
    alone = Conventions(wrench_delay=0.1).read(OWN, CENTROID)
    read = Conventions(wrench_delay=0.1).read(both, CENTROID)
    np.testing.assert_array_equal(read.force, np.tile(alone.force, (2, 1)))


def test_poses_alone():
    poses = replace(OWN, force=None, torque=None)
    read = Conventions(flip_wrench=True, torque_about="origin").read(poses, CENTROID)
    assert read.force is None


def motion(seed):
    rng = np.random.default_rng(seed)
    out = np.eye(4)
    out[:3, :3] = Rotation.random(rng=rng).as_matrix()
    out[:3, 3] = rng.uniform(-1, 1, 3)
    return out


BASE_TO_SCAN, SCAN_TO_PATIENT = motion(1), motion(2)


def in_frame(to_patient):
    """The own recording as a frame sees it, by points rather than by rotations."""
    back = np.linalg.inv(to_patient)
    turn = back[:3, :3]
    return replace(
        OWN,
        position=(back @ np.c_[OWN.position, np.ones(len(OWN))].T).T[:, :3],
        rotation=np.array([turn @ r for r in OWN.rotation]),
        force=np.array([turn @ f for f in OWN.force]),
        torque=np.array([turn @ m for m in OWN.torque]),
    )


def test_recordings_in_the_scan_and_in_the_robots_base():
    scan = in_frame(SCAN_TO_PATIENT)
    told = Conventions(frame="scan")
    assert told.wrench_frame == "scan"
    same(told.read(scan, CENTROID, SCAN_TO_PATIENT), OWN)
    same(told.as_recorded(OWN, CENTROID, SCAN_TO_PATIENT), scan)
    base = in_frame(SCAN_TO_PATIENT @ BASE_TO_SCAN)
    motions = tuple(map(tuple, BASE_TO_SCAN.tolist()))
    told = Conventions(frame="base", base_to_scan=motions)
    same(told.read(base, CENTROID, SCAN_TO_PATIENT), OWN)
    same(told.as_recorded(OWN, CENTROID, SCAN_TO_PATIENT), base)
    # poses of a camera, wrenches in the axes of the robot's base
    mixed = replace(scan, force=base.force, torque=base.torque)
    told = Conventions(frame="scan", wrench_frame="base", base_to_scan=motions)
    same(told.read(mixed, CENTROID, SCAN_TO_PATIENT), OWN)
    # and a wrench in the tool's axes is the same whatever frame the poses are in
    turn = OWN.rotation.transpose(0, 2, 1)
    tool = replace(
        base,
        force=(turn @ OWN.force[..., None])[..., 0],
        torque=(turn @ OWN.torque[..., None])[..., 0],
    )
    told = Conventions(frame="base", wrench_frame="tool", base_to_scan=motions)
    same(told.read(tool, CENTROID, SCAN_TO_PATIENT), OWN)
    assert told.options == "--wrench-frame tool --base-to-scan …"
    with pytest.raises(InputError, match="frame scan needs the surface's place"):
        Conventions(frame="scan").read(scan, CENTROID)


def test_forces_alone():
    turn = OWN.rotation.transpose(0, 2, 1)
    written = replace(OWN, force=-(turn @ OWN.force[..., None])[..., 0], torque=None)
    told = Conventions(wrench_frame="tool", flip_wrench=True, torque_about="origin")
    read = told.read(written, CENTROID)
    np.testing.assert_allclose(read.force, OWN.force, atol=1e-12)
    assert read.torque is None


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"quaternion": "zyxw"}, "quaternion must be one of wxyz, xyzw"),
        ({"wrench_frame": "hand"}, "wrench_frame must be one of patient, .* tool"),
        ({"frame": "tool"}, "frame must be one of patient, scan, base"),
        ({"frame": "base"}, "needs base_to_scan"),
        ({"wrench_frame": "base"}, "needs base_to_scan"),
        ({"base_to_scan": np.eye(4)}, "frame is patient, give base"),
        ({"frame": "base", "base_to_scan": 2 * np.eye(4)}, "4, 4|ends in the row"),
        ({"torque_unit": "ftlb"}, "torque_unit must be one of Nm, Nmm"),
        ({"torque_about": "tip"}, "centroid, origin or x,y,z"),
        ({"torque_about": (0.0, 0.0, 0.0, 0.0)}, "torque_about must be a point"),
        ({"torque_about": (0.0, np.nan, 0.0)}, "torque_about must be a point"),
        ({"wrench_delay": np.inf}, "wrench_delay must be finite"),
    ],
)
def test_refusals(wrong, text):
    refuses(InputError, text, Conventions, **wrong)

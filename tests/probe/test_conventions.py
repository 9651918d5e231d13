"""Recordings written otherwise are read as what they are."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.conftest import presses, torso
from ttus_opt.errors import InputError
from ttus_opt.probe.conventions import Conventions
from ttus_opt.probe.trajectory import Trajectory

CENTROID = np.array([0.01, -0.02, 0.06])
OWN = presses(torso(), 12, np.random.default_rng(5))


def same(a: Trajectory, b: Trajectory) -> None:
    for name in ("rotation", "position", "force", "torque"):
        np.testing.assert_allclose(getattr(a, name), getattr(b, name), atol=1e-12)


def test_the_packages_own() -> None:
    same(Conventions().read(OWN, CENTROID), OWN)


def test_a_quaternion_written_x_first() -> None:
    q = OWN.quat_wxyz
    # a reader of w, x, y, z takes x for w, y for x, z for y and w for z
    misread = Rotation.from_quat(q[:, [1, 2, 3, 0]], scalar_first=True).as_matrix()
    written = replace(OWN, rotation=misread)
    same(Conventions(quaternion="xyzw").read(written, CENTROID), OWN)


def test_a_wrench_in_the_tools_axes_of_the_probe_on_the_patient() -> None:
    turn = OWN.rotation.transpose(0, 2, 1)
    written = replace(
        OWN,
        force=-(turn @ OWN.force[..., None])[..., 0],
        torque=-1e3 * (turn @ OWN.torque[..., None])[..., 0],
    )
    told = Conventions(wrench_frame="tool", flip_wrench=True, torque_unit="Nmm")
    same(told.read(written, CENTROID), OWN)


def test_torques_about_another_point() -> None:
    """The moment of f at the centroid about the origin is added: τ_o = τ_c + r × f."""
    r = OWN.rotation @ CENTROID
    written = replace(OWN, torque=OWN.torque + np.cross(r, OWN.force))
    told = Conventions(torque_about="origin")
    same(told.read(written, CENTROID), OWN)
    same(told.torque_as_recorded(OWN, CENTROID), written)
    point = Conventions(torque_about=(0.01, -0.02, 0.06))
    same(point.read(OWN, CENTROID), OWN)


def test_wrenches_that_lag() -> None:
    """A force that grows linearly is known between frames, too."""
    ramp = np.outer(OWN.time, [1.0, 2.0, 3.0])
    late = replace(OWN, force=ramp - 0.08 * np.array([1.0, 2.0, 3.0]))
    read = Conventions(wrench_delay=0.08).read(late, CENTROID)
    np.testing.assert_allclose(read.force[:-2], ramp[:-2], atol=1e-12)


def test_recordings_are_not_mixed_by_a_lag() -> None:
    both = Trajectory.concatenate([OWN, OWN])
    alone = Conventions(wrench_delay=0.1).read(OWN, CENTROID)
    read = Conventions(wrench_delay=0.1).read(both, CENTROID)
    np.testing.assert_array_equal(read.force, np.tile(alone.force, (2, 1)))


def test_poses_alone() -> None:
    poses = replace(OWN, force=None, torque=None)
    read = Conventions(flip_wrench=True, torque_about="origin").read(poses, CENTROID)
    assert read.force is None


@pytest.mark.parametrize(
    ("wrong", "text"),
    [
        ({"quaternion": "zyxw"}, "quaternion must be wxyz or xyzw"),
        ({"wrench_frame": "base"}, "wrench_frame must be patient or tool"),
        ({"torque_unit": "ftlb"}, "torque_unit must be Nm or Nmm"),
        ({"torque_about": "tip"}, "centroid, origin or x,y,z"),
        ({"torque_about": (0.0, 0.0, 0.0, 0.0)}, "torque_about must be a point"),
        ({"torque_about": (0.0, np.nan, 0.0)}, "torque_about must be a point"),
        ({"wrench_delay": np.inf}, "wrench_delay must be finite"),
    ],
)
def test_refusals(wrong: dict[str, object], text: str) -> None:
    with pytest.raises(InputError, match=text):
        Conventions(**wrong)  # type: ignore[arg-type]

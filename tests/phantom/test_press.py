"""Presses of a probe into simulated tissue, and contact that only pushes."""

import dataclasses
import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.kit import GeometryError, InputError, refuses
from ttus_opt.phantom.example_data import PROBE, poses
from ttus_opt.phantom.press import CoulombDrag, Motion, press, solve_unilateral
from ttus_opt.phantom.probe import EllipsoidProbe

REST = Motion(np.zeros(3), np.zeros(3))


@pytest.fixture(scope="module")
def pose():
    """A tilted push of several newtons."""
    path = poses("press_fit")
    reach = path.position @ np.array([0.0, 1.0, 0.0])
    m = int(np.argmin(reach))
    return path.rotation[m], path.position[m]


def test_energy_gradient_is_the_wrench(coarse_patch, pose):
    rotation, position = pose
    contact = press(coarse_patch, PROBE, rotation, position)
    assert np.linalg.norm(contact.force) > 2.0
    h = 1e-7

    def energy(turn, shift):
        turned = Rotation.from_rotvec(turn).as_matrix() @ rotation
        return press(coarse_patch, PROBE, turned, position + shift).energy

    none = np.zeros(3)
    for axis in range(3):
        step = np.eye(3)[axis] * h
        force = (energy(none, -step) - energy(none, step)) / (2 * h)
        torque = (energy(-100 * step, none) - energy(100 * step, none)) / (200 * h)
        assert force == pytest.approx(contact.force[axis], abs=1e-4)
        assert torque == pytest.approx(contact.torque[axis], abs=1e-6)


def test_nothing_is_pulled_and_nothing_interpenetrates(coarse_patch, pose):
    contact = press(coarse_patch, PROBE, *pose)
    assert (contact.normal_forces > 0.0).all()
    nodal = np.zeros(len(coarse_patch.points))
    inward = -coarse_patch.normals[contact.nodes]
    cosine = np.einsum("ij,ij->i", contact.probe_normals, inward)
    nodal[contact.nodes] = contact.normal_forces * cosine
    moved = coarse_patch.points - (
        (coarse_patch.compliance @ nodal)[:, None] * coarse_patch.normals
    )
    rotation, position = pose
    level = np.linalg.norm((moved - position) @ rotation / PROBE.semi_axes, axis=1)
    assert level.min() > 1.0 - 1e-9
    assert level[contact.nodes] == pytest.approx(1.0, abs=1e-9)


def test_no_force_out_of_contact_and_a_small_one_just_in_it(coarse_patch):
    up = np.array([0.0, 1.0, 0.0])
    top = coarse_patch.points[np.argmin(np.abs(coarse_patch.points[:, 0]))]
    sphere = EllipsoidProbe((0.02, 0.02, 0.02))
    base = np.array([0.0, top[1], 0.15])
    clear = press(coarse_patch, sphere, np.eye(3), base + 0.03 * up)
    assert not clear.force.any() and not clear.torque.any() and clear.energy == 0.0
    forces = [
        press(coarse_patch, sphere, np.eye(3), base + (0.02 - d) * up).force[1]
        for d in (0.004, 0.008, 0.012)
    ]
    assert forces[0] > 0.0
    assert (np.diff(forces) > 0.0).all()
    assert (np.diff(forces, 2) > 0.0).all()  # a growing contact stiffens


def test_drag_is_mu_times_normal_force_against_the_motion(coarse_patch, pose):
    rotation, position = pose
    smooth = press(coarse_patch, PROBE, rotation, position)
    motion = Motion(np.array([0.004, 0.0, 0.01]), np.array([0.1, 0.2, -0.1]))
    rough = press(
        coarse_patch, PROBE, rotation, position, motion=motion, drag=CoulombDrag(0.25)
    )
    assert np.array_equal(rough.normal_forces, smooth.normal_forces)
    lever = rough.points - position
    slide = motion.velocity + np.cross(motion.angular_velocity, lever)
    normal = rough.probe_normals
    slide -= np.einsum("ij,ij->i", slide, normal)[:, None] * normal
    unit = slide / np.linalg.norm(slide, axis=1, keepdims=True)
    drag = -0.25 * rough.normal_forces[:, None] * unit
    assert rough.force - smooth.force == pytest.approx(drag.sum(axis=0), abs=1e-12)
    assert rough.torque - smooth.torque == pytest.approx(
        np.cross(lever, drag).sum(axis=0), abs=1e-12
    )
    assert (rough.force - smooth.force) @ motion.velocity < 0.0


def test_no_drag_at_rest_nor_within_the_deadband(coarse_patch, pose):
    smooth = press(coarse_patch, PROBE, *pose)
    drag = CoulombDrag(0.25, deadband=1e-3)
    slow = Motion(np.array([0.0, 0.0, 0.9e-3]), np.zeros(3))
    for motion in (None, REST, slow):
        rough = press(coarse_patch, PROBE, *pose, motion=motion, drag=drag)
        assert np.array_equal(rough.force, smooth.force)
    fast = Motion(np.array([0.0, 0.0, 1e-2]), np.zeros(3))
    rough = press(coarse_patch, PROBE, *pose, motion=fast, drag=drag)
    assert rough.force[2] < smooth.force[2] - 0.1


def test_refuses_poses_the_patch_says_nothing_about(coarse_patch, pose):
    rotation, position = pose
    with pytest.raises(GeometryError, match="not above the skin patch"):
        press(coarse_patch, PROBE, rotation, position + np.array([0.0, 0.0, 0.2]))
    with pytest.raises(GeometryError, match="below the undeformed skin"):
        press(coarse_patch, PROBE, rotation, position - np.array([0.0, 0.04, 0.0]))
    along = Rotation.from_euler("y", 90, degrees=True).as_matrix() @ rotation
    with pytest.raises(GeometryError, match="border"):
        press(coarse_patch, PROBE, along, position + np.array([0.0, 0.0, 0.085]))


def test_refuses_negative_drag():
    refuses(InputError, "must not be negative", CoulombDrag, -0.1)
    with pytest.raises(InputError, match="must not be negative"):
        dataclasses.replace(CoulombDrag(0.1), deadband=-1.0)


def test_damping_adds_to_every_normal_force_by_its_speed(coarse_patch, pose):
    motion = Motion(np.array([0.002, -0.02, 0.01]), np.array([0.2, 0.1, -0.3]))
    slow = press(coarse_patch, PROBE, *pose)
    fast = press(coarse_patch, PROBE, *pose, motion=motion, damping=3.0)
    lever = slow.points - pose[1]
    velocity = motion.velocity + np.cross(motion.angular_velocity, lever)
    speed = np.einsum("ij,ij->i", velocity, slow.probe_normals)
    factor = 1.0 + 3.0 * speed
    assert factor.max() > 1.02
    assert fast.normal_forces == pytest.approx(factor * slow.normal_forces, rel=1e-12)
    added = (fast.force - slow.force) @ motion.velocity
    added += (fast.torque - slow.torque) @ motion.angular_velocity
    assert added < 0.0  # it takes energy from the hand


def test_damping_never_pulls_and_rest_has_none(coarse_patch, pose):
    away = Motion(np.array([0.0, 1.0, 0.0]), np.zeros(3))
    contact = press(coarse_patch, PROBE, *pose, motion=away, damping=10.0)
    assert not contact.force.any()
    slow = press(coarse_patch, PROBE, *pose, motion=REST, damping=10.0)
    assert np.array_equal(slow.force, press(coarse_patch, PROBE, *pose).force)
    refuses(InputError, "damping", press, coarse_patch, PROBE, *pose, damping=-1.0)


def problem(seed, n):
    """A random compliance, definite, and depths of both signs."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    return root @ root.T + 0.1 * np.eye(n), rng.normal(size=n)


def brute_force(compliance, depth):
    """Try every set of touching nodes."""
    n = len(depth)
    for size in range(n + 1):
        for nodes in itertools.combinations(range(n), size):
            index = list(nodes)
            forces = np.zeros(n)
            if index:
                block = compliance[np.ix_(index, index)]
                forces[index] = np.linalg.solve(block, depth[index])
            gap = compliance @ forces - depth
            if (forces >= -1e-10).all() and (gap >= -1e-10).all():
                return forces
    raise AssertionError("no answer")


@settings(max_examples=60)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 7))
def test_equals_brute_force(seed, n):
    compliance, depth = problem(seed, n)
    answer = solve_unilateral(compliance, depth)
    assert answer == pytest.approx(brute_force(compliance, depth), abs=1e-8)


@settings(max_examples=40)
@given(seed=st.integers(0, 10**6), n=st.integers(1, 60))
def test_conditions_hold(seed, n):
    compliance, depth = problem(seed, n)
    answer = solve_unilateral(compliance, depth)
    gap = compliance @ answer - depth
    assert (answer >= 0.0).all()
    assert gap.min() >= -1e-9 * np.abs(depth).max()
    assert abs(answer @ gap) <= 1e-8 * (1.0 + answer.sum())


def test_refuses_wrong_shapes_and_indefinite_compliance():
    refuses(InputError, r"\(3, 3\)", solve_unilateral, np.eye(2), np.ones(3))
    refuses(InputError, "positive definite", solve_unilateral, -np.eye(3), np.ones(3))

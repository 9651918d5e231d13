"""The same recordings, read otherwise: conventions and axes that are often mistaken."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.probe.conventions import QUATERNIONS, Conventions
from ttus_opt.probe.trajectory import Trajectory

#: Delays of the wrenches to try [s]
DELAYS = tuple(round(0.1 * i, 1) for i in range(-6, 7) if i)

#: Distance of the centroid from the pose's origin below which both are the same [m]
NEAR = 3e-3


class Reading(NamedTuple):
    """Recordings read otherwise.

    Attributes:
        what: Description of the difference.
        mends: The options of ``ttus-opt fit`` that read them so; empty for none.
        cause: What differs: a field of `Conventions`, ``columns``, or axes.
        recorded: The recordings, patient frame.
    """

    what: str
    mends: str
    cause: str
    recorded: Trajectory


def other_readings(
    scene: Scene, written: Trajectory, conventions: Conventions
) -> Iterator[Reading]:
    """The recordings of files, read by other conventions.

    Args:
        scene: The shell, and the patient's frame.
        written: The recordings as in the files.
        conventions: How they were read.
    """
    centroid = np.asarray(scene.shell.reference)
    place = scene.voxmap.surface.axis.scan_to_patient
    given = asdict(conventions)
    for other in _other_conventions(conventions, centroid, written):
        reread = other.read(written, centroid, place)
        cause = next(k for k, v in asdict(other).items() if v != given[k])
        yield Reading(_difference(conventions, other), other.options, cause, reread)
    for what, columns, swapped in _swapped(written):
        mends = f"--columns {columns} {conventions.options}".rstrip()
        reread = conventions.read(swapped, centroid, place)
        yield Reading(what, mends, "columns", reread)


def _swapped(written: Trajectory) -> Iterator[tuple[str, str, Trajectory]]:
    """The file's columns in another order."""
    swap = [1, 0, 2]
    position = written.position[:, swap]
    yield (
        "columns px and py swapped",
        "px=py,py=px",
        replace(written, position=position),
    )
    assert written.force is not None
    force, torque = written.force[:, swap], written.torque
    if torque is None:
        what, columns = "columns fx and fy swapped", "fx=fy,fy=fx"
    else:
        what, columns = (
            "columns fx and fy, tx and ty swapped",
            "fx=fy,fy=fx,tx=ty,ty=tx",
        )
        torque = torque[:, swap]
    yield what, columns, replace(written, force=force, torque=torque)


def _other_conventions(
    conventions: Conventions, centroid: Array, written: Trajectory
) -> Iterator[Conventions]:
    """Conventions that are often mistaken for the given ones."""
    axes = dict.fromkeys((conventions.frame, conventions.wrench_frame, "tool"))
    for quaternion, wrench_frame, flip in itertools.product(
        QUATERNIONS, axes, (False, True)
    ):
        if "base" in (conventions.frame, conventions.wrench_frame) and "base" not in (
            conventions.frame,
            wrench_frame,
        ):
            continue  # base_to_scan would be unused
        other = replace(
            conventions,
            quaternion=quaternion,
            wrench_frame=wrench_frame,
            flip_wrench=flip,
        )
        if other != conventions:
            yield other
    if np.linalg.norm(centroid) > NEAR:
        about = "origin" if conventions.torque_about == "centroid" else "centroid"
        yield replace(conventions, torque_about=about)
    for delay in DELAYS:
        total = round(conventions.wrench_delay + delay, 9)
        if abs(total) < np.ptp(written.time):
            yield replace(conventions, wrench_delay=total)


def _difference(conventions: Conventions, other: Conventions) -> str:
    """Description of the difference to another convention."""
    words = []
    if other.quaternion != conventions.quaternion:
        words.append(f"quaternions {', '.join(other.quaternion)}")
    if other.wrench_frame != conventions.wrench_frame:
        words.append(f"wrenches in the {other.wrench_frame}'s axes")
    if other.flip_wrench != conventions.flip_wrench:
        words.append("forces of the opposite sign")
    if other.torque_about != conventions.torque_about:
        words.append(f"torques about the {other.torque_about}")
    if other.wrench_delay != conventions.wrench_delay:
        late = other.wrench_delay - conventions.wrench_delay
        words.append(f"wrenches {abs(late):.1g} s {'later' if late > 0 else 'earlier'}")
    return " and ".join(words)


def contact_readings(scene: Scene) -> Iterator[Reading]:
    """Contact wrenches and poses of a scene with other signs, times and axes.

    Axes are turned by every rotation that maps them on each other, the smallest first:
    a symmetric probe looks alike after some of them.
    """
    trajectory, centroid = scene.trajectory, np.asarray(scene.shell.reference)
    usual = Conventions()
    for other in _other_conventions(usual, centroid, trajectory):
        if other.quaternion == usual.quaternion:
            cause = "flip_wrench" if other.flip_wrench else "wrench_frame"
            cause = "wrench_delay" if other.wrench_delay else cause
            what = _difference(usual, other)
            yield Reading(what, "", cause, other.read(trajectory, centroid))
    assert trajectory.force is not None
    turns = sorted(Rotation.create_group("O"), key=lambda turn: turn.magnitude())
    for turn in turns[1:]:
        P = turn.as_matrix()
        rotation = trajectory.rotation @ P
        turned = rotation @ trajectory.rotation.transpose(0, 2, 1)
        force = np.einsum("tij,tj->ti", turned, trajectory.force)
        torque, shifted = trajectory.torque, trajectory.torque
        if trajectory.torque is not None:
            torque = np.einsum("tij,tj->ti", turned, trajectory.torque)
            arm = trajectory.rotation @ (P @ centroid - centroid)
            shifted = trajectory.torque - np.cross(arm, trajectory.force)
        axis = turn.as_rotvec() / turn.magnitude()
        named = ", ".join(f"{v:.2g}" for v in axis)
        how = f"turned by {np.degrees(turn.magnitude()):.0f}° about ({named})"
        for what, cause, reread in (
            ("probe and wrenches", "probe_axes", (rotation, force, torque)),
            ("the probe", "probe_axes", (rotation, trajectory.force, shifted)),
            ("wrenches", "wrench_axes", (trajectory.rotation, force, torque)),
        ):
            R, f, tau = reread
            recorded = replace(trajectory, rotation=R, force=f, torque=tau)
            yield Reading(f"{what} {how} in the probe's axes", "", cause, recorded)

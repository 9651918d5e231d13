"""Rigid motions between frames: robot base, scan, patient.

A motion is a matrix (4, 4), named after what it maps: ``base_to_scan`` is x_scan =
R x_base + t. Files and option values give that matrix (text, CSV, NPY, JSON), or the
position x, y, z [m] followed by a quaternion x, y, z, w, as in ROS.
"""

from __future__ import annotations

import json
import os
from collections.abc import Iterable
from pathlib import Path
from typing import TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError, located
from ttus_opt.probe.pose import ROUNDING, PoseLike, from_quaternions, pose_of, rotations

#: A motion as a value that can be compared and written as JSON
Rows: TypeAlias = tuple[tuple[float, ...], ...]

#: Translations beyond this are in another unit [m]
LARGEST_SHIFT = 10.0

#: Largest file of a motion [byte]
LARGEST_FILE = 100_000


def rigid_motion(motion: PoseLike) -> Array:
    """A validated rigid motion, shape (4, 4); rounding of up to 1e-5 is corrected.

    Args:
        motion: Matrix (4, 4) or SciPy `RigidTransform`; translation in metres.

    Raises:
        InputError: Another shape, a scale, reflection or shear, a translation in
            millimetres, or numbers that are not finite.

    Examples:
        >>> rigid_motion(np.diag([2.0, 2.0, 2.0, 1.0]))  # doctest: +ELLIPSIS
        Traceback (most recent call last):
        ...
        ttus_opt.core.errors.InputError: not a rigid motion: it scales by 2...
    """
    as_matrix = getattr(motion, "as_matrix", None)
    matrix = np.asarray(motion if as_matrix is None else as_matrix(), dtype=np.float64)
    if matrix.shape != (4, 4):
        raise InputError(f"a rigid motion is a matrix (4, 4), got {matrix.shape}")
    if not np.isfinite(matrix).all():
        raise InputError("a rigid motion contains NaN or infinite values")
    turn, shift = pose_of(matrix)
    scale = float(np.sqrt((turn**2).sum() / 3.0))
    uniform = np.abs(turn.T @ turn - scale**2 * np.eye(3)).max() < ROUNDING * scale**2
    if uniform and abs(scale - 1.0) > ROUNDING:
        raise InputError(
            f"not a rigid motion: it scales by {scale:.6g}: remove the scale"
        )
    most = float(np.abs(shift).max())
    if most > LARGEST_SHIFT:
        raise InputError(
            f"a rigid motion shifts by {most:.6g} m, more than {LARGEST_SHIFT:g}: "
            "millimetres? divide the shift by 1000"
        )
    with located("no rigid motion"):
        return homogeneous(rotations(turn), shift)


def homogeneous(rotation: ArrayLike, position: ArrayLike) -> Array:
    """Rotations (…, 3, 3) and positions (…, 3) as matrices (…, 4, 4)."""
    turn = np.asarray(rotation, dtype=np.float64)
    out = np.zeros((*turn.shape[:-2], 4, 4))
    out[..., :3, :3] = turn
    out[..., :3, 3] = position
    out[..., 3, 3] = 1.0
    return out


def inverse(motion: Array) -> Array:
    """The inverses of motions (…, 4, 4)."""
    turn = np.swapaxes(motion[..., :3, :3], -1, -2)
    return homogeneous(turn, -(turn @ motion[..., :3, 3:])[..., 0])


def motion_of(six: ArrayLike) -> Array:
    """The motion (4, 4) of a rotation vector [rad] and a shift [m]."""
    values = np.asarray(six, dtype=np.float64)
    return homogeneous(Rotation.from_rotvec(values[:3]).as_matrix(), values[3:])


def six_of(motion: Array) -> Array:
    """Rotation vector [rad] and shift [m] of motions (…, 4, 4), shape (…, 6)."""
    turn = Rotation.from_matrix(motion[..., :3, :3]).as_rotvec()
    return np.concatenate([turn, motion[..., :3, 3]], axis=-1)


def left_jacobian(six: Array) -> Array:
    """Of a rotation vector and a shift, (6, 6): small turn after = J change of vector.

    On the rotations the left Jacobian of SO(3) (Chirikjian, Stochastic Models,
    Information Theory, and Lie Groups 2, 2012, 10.86); the identity for shifts.
    """
    angle = float(np.linalg.norm(six[:3]))
    K = np.cross(np.eye(3), six[:3])
    a, b = 0.5, 1.0 / 6.0
    if angle > 1e-4:
        a = (1.0 - np.cos(angle)) / angle**2
        b = (angle - np.sin(angle)) / angle**3
    J = np.eye(6)
    J[:3, :3] = np.eye(3) + a * K + b * K @ K
    return J


def composed(motions: Iterable[PoseLike]) -> Array:
    """One motion (4, 4) from several, applied in order; `InputError` as above."""
    matrix = np.eye(4)
    for motion in motions:
        matrix = rigid_motion(motion) @ matrix
    return matrix


def moved(points: Array, motion: Array) -> Array:
    """R x + t for points x, shape (n, 3) [m]."""
    return np.asarray(points @ motion[:3, :3].T + motion[:3, 3])


def as_rows(motion: Array) -> Rows:
    """The matrix as tuples."""
    return tuple(tuple(row) for row in motion.tolist())


def read_rigid_motion(source: str | os.PathLike[str]) -> Array:
    """A rigid motion (4, 4) from a string or a file.

    Args:
        source: ``x,y,z,qx,qy,qz,qw`` [m, –]; a matrix as JSON; or a file with either,
            or with the matrix (4, 4) as text, CSV, JSON or NPY.

    Raises:
        FileError: The file does not hold a rigid motion.
        InputError: The string does not.
    """
    text = os.fspath(source)
    try:
        values = _numbers(text)
    except ValueError:
        how = "a matrix (4, 4), or x,y,z,qx,qy,qz,qw"
        values = read_numbers(text, "a rigid motion", how, LARGEST_FILE)
        with located(text, FileError):
            return _motion(values)
    return _motion(values)


def write_rigid_motion(path: str | os.PathLike[str], motion: Array) -> None:
    """Write a motion (4, 4) as JSON, for `read_rigid_motion`."""
    io.write_text(path, json.dumps(motion.tolist()) + "\n")


def read_numbers(
    path: str | os.PathLike[str], what: str, how: str, largest: int
) -> Array:
    """Numbers of a NPY file, of JSON or of other text.

    Args:
        path: The file.
        what: What it should hold, for errors.
        how: What to write instead.
        largest: Largest accepted size [byte].

    Raises:
        FileError: Missing, or none that can be read.
    """
    file = io.existing_file(Path(path), what.removeprefix("a "), largest)
    try:
        if file.suffix.lower() == ".npy":
            return np.asarray(np.load(file, allow_pickle=False), dtype=np.float64)
        return _numbers(file.read_text(encoding="utf-8-sig"))
    except Exception as error:  # numpy raises nearly every class on damaged headers
        raise FileError(
            f"{file} cannot be read as {what} ({type(error).__name__}): write {how}"
        ) from error


def _numbers(text: str) -> Array:
    """Numbers as JSON, or between commas, semicolons or blanks; else `ValueError`."""
    if text.lstrip().startswith("["):
        return np.array(json.loads(text), dtype=np.float64)
    lines = [line.partition("#")[0] for line in text.splitlines()]
    words = " ".join(lines).replace(",", " ").replace(";", " ").split()
    if not words:
        raise ValueError("no numbers")
    return np.array([float(word) for word in words])


def _motion(values: Array) -> Array:
    """The motion of 7 or 16 numbers; `InputError` for any other count."""
    if values.size == 16:
        return rigid_motion(values.reshape(4, 4))
    if values.size != 7:
        raise InputError(
            "a rigid motion is a matrix (4, 4) or x,y,z,qx,qy,qz,qw, got "
            f"{values.size} numbers"
        )
    x = values.reshape(7)
    if not np.isfinite(x).all():
        raise InputError("a rigid motion contains NaN or infinite values")
    return rigid_motion(homogeneous(from_quaternions(x[None, 3:], "xyzw")[0], x[:3]))

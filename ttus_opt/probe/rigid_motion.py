"""Rigid motions between frames: robot base, scan, patient.

A motion is a matrix (4, 4) named after what it maps: ``base_to_scan`` is x_scan =
R x_base + t. Files and words say it as such a matrix (text, CSV, NPY, JSON) or as seven
numbers x, y, z [m] and a quaternion x, y, z, w, the order of ROS.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import TypeAlias

import numpy as np

from ttus_opt import io
from ttus_opt.arrays import Array
from ttus_opt.errors import FileError, InputError
from ttus_opt.probe.pose import ROUNDING, PoseLike, from_quaternions, pose_of, rotations

#: A motion as a value that can be compared and written as JSON
Rows: TypeAlias = tuple[tuple[float, ...], ...]

#: Shifts beyond this are in another unit [m]
LARGEST_SHIFT = 10.0

#: Largest file of a motion [byte]
LARGEST_FILE = 100_000


def rigid_motion(motion: PoseLike) -> Array:
    """A rigid motion, checked.

    Args:
        motion: Matrix (4, 4) or SciPy `RigidTransform`; shifts in metres.

    Returns:
        Matrix, shape (4, 4); rounding of up to 1e-5 is corrected.

    Raises:
        InputError: Another shape, a scale, a reflection, a shear, a shift in
            millimetres, or numbers that are not finite.

    Examples:
        >>> rigid_motion(np.diag([2.0, 2.0, 2.0, 1.0]))
        Traceback (most recent call last):
        ...
        ttus_opt.errors.InputError: no rigid motion: it scales by 2: remove the scale
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
        raise InputError(f"no rigid motion: it scales by {scale:.6g}: remove the scale")
    most = float(np.abs(shift).max())
    if most > LARGEST_SHIFT:
        raise InputError(
            f"a rigid motion shifts by {most:.6g} m, over {LARGEST_SHIFT:g}: "
            "millimetres? divide the shift by 1000"
        )
    out = np.eye(4)
    try:
        out[:3, :3] = rotations(turn)
    except InputError as error:
        raise InputError(f"no rigid motion: {error}") from error
    out[:3, 3] = shift
    return out


def inverse(motion: Array) -> Array:
    """The motion back: ``inverse(base_to_scan)`` maps the scan to the base."""
    out = np.eye(4)
    out[:3, :3] = motion[:3, :3].T
    out[:3, 3] = -motion[:3, :3].T @ motion[:3, 3]
    return out


def as_rows(motion: Array) -> Rows:
    """The matrix as tuples."""
    return tuple(tuple(row) for row in motion.tolist())


def read_rigid_motion(told: str | os.PathLike[str]) -> Array:
    """A rigid motion from words or a file.

    Args:
        told: ``x,y,z,qx,qy,qz,qw`` [m, –]; a matrix as JSON; or a file with either, or
            with the matrix (4, 4) as text, CSV, JSON or NPY.

    Returns:
        Matrix, shape (4, 4).

    Raises:
        FileError: The file does not hold such numbers, or no rigid motion.
        InputError: The words do not.
    """
    text = os.fspath(told)
    try:
        values = _numbers(text)
    except ValueError:
        return _from_file(text)
    return _motion(values)


def _from_file(name: str) -> Array:
    """The motion of a file, or `FileError` where it holds none."""
    file = io.existing_file(Path(name), "rigid motion")
    if file.stat().st_size > LARGEST_FILE:
        raise FileError(f"{file} is too large for a matrix (4, 4): wrong file?")
    try:
        if file.suffix.lower() == ".npy":
            values = np.asarray(np.load(file, allow_pickle=False), dtype=np.float64)
        else:
            values = _numbers(file.read_text(encoding="utf-8-sig"))
    except Exception as error:  # numpy raises nearly every class on damaged headers
        raise FileError(
            f"{file} does not read as a rigid motion ({type(error).__name__}): write a "
            "matrix (4, 4), or x,y,z,qx,qy,qz,qw"
        ) from error
    try:
        return _motion(values)
    except InputError as error:
        raise FileError(f"{file}: {error}") from error


def _numbers(text: str) -> Array:
    """Numbers, JSON or apart by commas, semicolons or blanks; else `ValueError`."""
    if text.lstrip().startswith("["):
        return np.array(json.loads(text), dtype=np.float64)
    lines = [line.partition("#")[0] for line in text.splitlines()]
    words = " ".join(lines).replace(",", " ").replace(";", " ").split()
    if not words:
        raise ValueError("no numbers")
    return np.array([float(word) for word in words])


def _motion(values: Array) -> Array:
    """The motion that 7 or 16 numbers stand for, or `InputError`."""
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
    out = np.eye(4)
    out[:3, :3] = from_quaternions(x[None, 3:], "xyzw")[0]
    out[:3, 3] = x[:3]
    return rigid_motion(out)

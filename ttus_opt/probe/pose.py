"""One pose or many, from any common representation.

A pose is the rotation matrix R from probe to patient axes and the position of the probe
frame's origin in the patient frame. R may be given as a matrix, a SciPy `Rotation`, a
unit quaternion whose order is named, or within a homogeneous 4×4 matrix.

A rotation matrix rounded to float32 has an ‖RᵀR − I‖ of about 1e-6. Up to `ROUNDING` it
is replaced by the nearest rotation. A matrix farther off has scale or shear, and is
refused.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform, Rotation

QuaternionOrder = Literal["wxyz", "xyzw"]

#: What `Renderer.render` takes as a rotation, or as a whole pose
PoseLike: TypeAlias = "ArrayLike | Rotation | RigidTransform"

#: Largest entry of |RᵀR − I| that is corrected as rounding, and largest that is
#: accepted without correction [–]
ROUNDING, EXACT = 1e-5, 1e-12

#: Largest deviation of a quaternion's length from 1, before normalisation [–]
QUATERNION_TOLERANCE = 0.01

#: Largest departure of a device's matrix from orthonormal that is projected: three
#: or four digits, as some trackers write them [–]
DEVICE_ROUNDING = 1e-3


class Pose(NamedTuple):
    """Pose of the probe, once or at T times.

    Attributes:
        rotation: Probe to patient, shape (3, 3) or (T, 3, 3) [–].
        position: Origin of the probe frame, patient frame, (3,) or (T, 3) [m].
    """

    rotation: Array
    position: Array


def pose_of(
    rotation: PoseLike,
    position: ArrayLike | None = None,
    order: QuaternionOrder | None = None,
) -> Pose:
    """A pose from any representation.

    Args:
        rotation: Matrix (3, 3), SciPy `Rotation`, quaternion (4,); or the whole pose
            as a matrix (4, 4) or a SciPy `RigidTransform`.
        position: Shape (3,) [m]; None with a whole pose.
        order: Order of a quaternion: ``wxyz``, or ``xyzw`` as in ROS.

    Returns:
        Matrix and position; the matrix is not checked, see `rotations`.

    Raises:
        InputError: Another shape, a position missing or given twice, a quaternion
            without its order or not of unit length.

    Examples:
        >>> pose_of([0.0, 0.0, 0.0, 1.0], [0.1, 0.0, 0.0], "xyzw").rotation.tolist()
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    as_matrix = getattr(rotation, "as_matrix", None)
    matrix = np.asarray(rotation if as_matrix is None else as_matrix(), dtype=float)
    if matrix.shape == (4,):
        matrix = from_quaternions(matrix[None], order)[0]
    elif order is not None:
        raise InputError(f"order {order!r} is of a quaternion (4,), got {matrix.shape}")
    elif matrix.shape == (4, 4) and position is None:
        if np.abs(matrix[3] - [0.0, 0.0, 0.0, 1.0]).max() > ROUNDING:
            raise InputError(
                f"a pose (4, 4) ends in the row 0, 0, 0, 1, got {matrix[3].tolist()}: "
                "transposed?"
            )
        matrix, position = matrix[:3, :3], matrix[:3, 3]
    at = np.asarray(np.nan if position is None else position, dtype=float)
    if matrix.shape != (3, 3) or at.shape != (3,):
        given = "no position" if position is None else f"position {at.shape}"
        raise InputError(
            "a pose needs rotation (3, 3), a SciPy Rotation or a quaternion (4,), and "
            "position (3,) [m]; or a matrix (4, 4) alone; got rotation "
            f"{matrix.shape} and {given}"
        )
    return Pose(matrix, at)


def poses_of(
    positions: ArrayLike | None,
    orientations: PoseLike,
    order: QuaternionOrder | None = None,
) -> Pose:
    """Poses from any representation.

    Args:
        positions: Shape (T, 3) [m]; None with whole poses.
        orientations: Matrices (T, 3, 3), SciPy `Rotation`, quaternions (T, 4); or whole
            poses as matrices (T, 4, 4) or SciPy `RigidTransform`.
        order: Order of quaternions: ``wxyz``, or ``xyzw`` as in ROS and SciPy.

    Returns:
        Matrices and positions; the matrices are not checked, see `rotations`.

    Raises:
        InputError: Another shape, positions missing or given twice, quaternions without
            their order or not of unit length.
    """
    as_matrix = getattr(orientations, "as_matrix", None)
    given = orientations if as_matrix is None else as_matrix()
    matrices = np.asarray(given, dtype=np.float64)
    if matrices.ndim == 2 and matrices.shape[1] == 4 and positions is not None:
        matrices = from_quaternions(matrices, order)
    elif order is not None:
        raise InputError(f"order {order!r} is of quaternions (T, 4) and positions")
    elif matrices.ndim == 3 and matrices.shape[1:] == (4, 4) and positions is None:
        for matrix in matrices:
            pose_of(matrix)  # validates its last row
        return Pose(matrices[:, :3, :3], matrices[:, :3, 3])
    at = np.asarray(np.nan if positions is None else positions, dtype=np.float64)
    if matrices.shape[1:] != (3, 3) or at.shape != (len(matrices), 3):
        found = "no positions" if positions is None else f"positions {at.shape}"
        raise InputError(
            "poses need orientations (T, 3, 3), a SciPy Rotation or quaternions "
            "(T, 4), and positions (T, 3) [m]; or matrices (T, 4, 4) alone; got "
            f"orientations {matrices.shape} and {found}"
        )
    return Pose(matrices, at)


def from_quaternions(quaternions: Array, order: QuaternionOrder | None) -> Array:
    """Rotation matrices of unit quaternions, shape (T, 3, 3) [–].

    Args:
        quaternions: Shape (T, 4) [–]; lengths within 1 % of 1 are normalised.
        order: ``wxyz`` or ``xyzw``.

    Raises:
        InputError: No order, or lengths that are not 1.
    """
    from scipy.spatial.transform import Rotation

    if order not in get_args(QuaternionOrder):
        raise InputError(
            f"a quaternion needs order='wxyz' or order='xyzw' (ROS), got {order!r}"
        )
    with np.errstate(over="ignore"):  # of damaged numbers
        length = np.linalg.norm(quaternions, axis=1)
    if not (np.abs(length - 1.0) <= QUATERNION_TOLERANCE).all():
        worst = length[np.argmax(np.abs(length - 1.0))]
        raise InputError(
            f"a quaternion has length {worst:.6g}, expected 1: normalise it"
        )
    scalar_first = order == "wxyz"
    return np.asarray(
        Rotation.from_quat(quaternions, scalar_first=scalar_first).as_matrix()
    )


def to_quaternions(matrices: Array) -> Array:
    """Unit quaternions w, x, y, z with w ≥ 0 of matrices (T, 3, 3), shape (T, 4)."""
    from scipy.spatial.transform import Rotation

    return np.asarray(
        Rotation.from_matrix(matrices).as_quat(canonical=True, scalar_first=True)
    )


def rotations(matrices: Array, largest: float = ROUNDING) -> Array:
    """Rotation matrices, the nearest ones where they were rounded.

    Args:
        matrices: Shape (T, 3, 3), or one of shape (3, 3) [–].
        largest: Entry of |RᵀR − I| up to which it is rounding.

    Returns:
        The same shape; the same array where nothing was rounded.

    Raises:
        InputError: Values that are not finite, a matrix farther from orthonormal, or a
            reflection; the message has the frame's number.
    """
    if not np.isfinite(matrices).all():
        raise InputError("a rotation contains NaN or infinite values")
    if matrices.size == 0:
        return matrices
    error = _off(matrices)
    _refuse(error > largest, error, "orthonormal columns are expected")
    _refuse(
        np.linalg.det(matrices) < 0.0,
        error,
        "a reflection (determinant −1): swap two axes or change the sign of one",
    )
    if (rounded := error > EXACT).any():
        U, _, Vt = np.linalg.svd(matrices)
        matrices = np.where(rounded[..., None, None], U @ Vt, matrices)
    return matrices


def nearest_rotations(matrices: Array) -> tuple[Array, float]:
    """Rotations nearest to what a device sent with few digits.

    Args:
        matrices: Shape (T, 3, 3) [–].

    Returns:
        Rotations, and how far the worst matrix was off orthonormal, 0 where it was
        within `ROUNDING`.

    Raises:
        InputError: Farther off than `DEVICE_ROUNDING`, not finite, or a reflection.
    """
    found = rotations(matrices, DEVICE_ROUNDING)
    worst = float(_off(matrices).max(initial=0.0))
    return found, worst if worst > ROUNDING else 0.0


def _off(matrices: Array) -> Array:
    """Largest entry of |RᵀR − I| of every matrix [–]."""
    gram = np.swapaxes(matrices, -1, -2) @ matrices
    return np.asarray(np.abs(gram - np.eye(3)).max(axis=(-1, -2)))


def _refuse(bad: NDArray[np.bool_], error: Array, why: str) -> None:
    """Raise `InputError` for the first bad matrix."""
    if np.any(bad):
        first = int(np.argmax(bad))
        frame = f"frame {first}: " if np.ndim(bad) else ""
        off = np.atleast_1d(error)[first]
        raise InputError(
            f"{frame}not a rotation matrix, RᵀR is off the identity by {off:.2g} "
            f"(rounding up to {ROUNDING:g} is corrected): {why}"
        )

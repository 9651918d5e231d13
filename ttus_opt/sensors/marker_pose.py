"""Poses of square markers, and of boards of them, in a photo, with covariance.

OpenCV finds the markers and refines their corners by AprilTag's line fit. The pose is a
least-squares fit to the corners' pixels; its covariance is that of the linearised
problem, σ² (JᵀJ)⁻¹, with J the Jacobian of the projections with respect to rotation and
translation (docs/method/sensors.md, 18.1).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, InputError, warn
from ttus_opt.probe.rigid_motion import homogeneous, left_jacobian
from ttus_opt.sensors.image_file import decoded
from ttus_opt.sensors.intrinsics import Intrinsics

#: Root-mean-square reprojection error above which a pose gives a warning, and above
#: which it is refused [pixel]
DOUBTFUL, REFUSED = 2.0, 5.0

#: Lower limit of the corners' standard deviation, which few corners underestimate
#: [pixel]
LEAST_PIXEL_STD = 0.1

#: Least ratio of the errors of the two poses that fit a single marker; below it a
#: warning says that both fit
UNAMBIGUOUS = 2.0

#: Shortest and longest length on a board [m]
SHORTEST, LONGEST = 1e-4, 2.0

#: Largest image [byte, pixel]
LARGEST_FILE, LARGEST_IMAGE = 2**27, 2**26


@dataclass(frozen=True)
class MarkerPose:
    """Pose of a marker or a board in front of a camera.

    Attributes:
        markers: Numbers of the markers seen, ascending.
        pose: Marker or board to camera, shape (4, 4) [–, m]; OpenCV's camera axes: x
            right, y down, z forward.
        covariance: Covariance of a small rotation in camera axes [rad] and of the
            translation [m], in this order, shape (6, 6).
        residual: Root-mean-square reprojection error of the corners [pixel].
        other_residual: The same for the second pose that fits a single marker; None for
            boards.
    """

    markers: tuple[int, ...]
    pose: Array
    covariance: Array = field(repr=False)
    residual: float
    other_residual: float | None = None

    @property
    def turn_std(self) -> Array:
        """Standard deviations of the rotation, camera axes, shape (3,) [rad]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[:3]))

    @property
    def shift_std(self) -> Array:
        """Standard deviations of the translation, camera axes, shape (3,) [m]."""
        return np.asarray(np.sqrt(np.diag(self.covariance)[3:]))


@dataclass(frozen=True)
class Board:
    """A grid of markers, numbered row by row.

    Attributes:
        columns: Markers in a row.
        rows: Rows of markers.
        marker: Side of a marker [m].
        gap: Distance between two markers [m].
        dictionary: OpenCV's name, such as ``4X4_250`` or ``APRILTAG_36H11``.
    """

    columns: int
    rows: int
    marker: float
    gap: float
    dictionary: str

    def __post_init__(self) -> None:
        """Validate the board.

        Raises:
            InputError: Implausible counts or lengths.
        """
        if not (1 <= self.columns <= 100 and 1 <= self.rows <= 100):
            raise InputError(
                f"a board must have 1 to 100 columns and rows, got {self.columns} x "
                f"{self.rows}"
            )
        _check_length("marker", self.marker)
        _check_length("gap", self.gap)


def read_image(path: str | os.PathLike[str]) -> NDArray[np.uint8]:
    """A photo as grey values, shape (height, width).

    Raises:
        FileError: Missing, too large, or no image.
    """
    import cv2

    file = io.existing_file(path, "image", LARGEST_FILE)
    image = decoded(file, LARGEST_IMAGE, cv2.IMREAD_GRAYSCALE)
    if image.size > LARGEST_IMAGE:
        raise FileError(f"{file} has {image.size:,} pixels: save it smaller")
    return np.asarray(image, np.uint8)


def board_pose(
    image: NDArray[np.uint8], board: Board, camera: Intrinsics
) -> MarkerPose:
    """Pose of a board, from all of its markers that are seen.

    Args:
        image: Grey values, shape (height, width).
        board: The board.
        camera: Intrinsics of the camera that took the image.

    Raises:
        InputError: No marker of the board is seen, or no pose of such a board fits the
            corners.
    """
    camera.check_shape(image.shape)
    corners, numbers = _detected(image, board.dictionary)
    found = _fitted(board, corners, numbers, camera)
    if found is None:
        raise InputError(
            f"none of the markers seen, {_listed(numbers)}, is on a board of "
            f"{board.columns} x {board.rows}: give its columns, rows and dictionary"
        )
    if found.residual > REFUSED:
        turned = replace(board, columns=board.rows, rows=board.columns)
        other = _fitted(turned, corners, numbers, camera)
        hint = "check columns, rows, marker, gap and intrinsics"
        if other is not None and other.residual < DOUBTFUL:
            hint = (
                f"with {turned.columns} columns and {turned.rows} rows it is "
                f"{other.residual:.2g}"
            )
        raise InputError(
            f"the corners lie {found.residual:.3g} pixels from where a board of "
            f"{board.columns} columns and {board.rows} rows would have them: {hint}"
        )
    _uncertainty(found)
    return found


def marker_poses(
    image: NDArray[np.uint8], side: float, dictionary: str, camera: Intrinsics
) -> list[MarkerPose]:
    """Poses of single markers.

    The marker's frame has its origin in the middle, x to the right, y up and z towards
    the viewer.

    Args:
        image: Grey values, shape (height, width).
        side: Side of every marker [m].
        dictionary: OpenCV's name.
        camera: Intrinsics of the camera that took the image.

    Returns:
        One pose for every marker seen, ordered by number.

    Raises:
        InputError: No marker is seen, or an invalid side.
    """
    import cv2

    camera.check_shape(image.shape)
    _check_length("marker", side)
    corners, numbers = _detected(image, dictionary)
    half = side / 2.0
    points = half * np.array([[-1.0, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]])
    found = []
    for number, quad in sorted(
        zip(numbers.tolist(), corners, strict=True), key=lambda seen: int(seen[0])
    ):
        pixels = np.asarray(quad, np.float64).reshape(4, 2)
        _, turns, shifts, errors = cv2.solvePnPGeneric(
            points,
            pixels,
            camera.matrix,
            camera.distortion,
            flags=cv2.SOLVEPNP_IPPE_SQUARE,
        )
        other = float(errors[1, 0]) if len(errors) > 1 else None
        pose = _refined((int(number),), points, pixels, camera, (turns[0], shifts[0]))
        pose = replace(pose, other_residual=other)
        _uncertainty(pose)
        found.append(pose)
    return found


def _check_length(name: str, length: float) -> None:
    """Validate a length of a board."""
    if not SHORTEST < length < LONGEST:
        hint = ": is it in millimetres? Divide by 1000" if length >= LONGEST else ""
        raise InputError(
            f"{name} must be a length between {SHORTEST:g} and {LONGEST:g} m, got "
            f"{length:g}{hint}"
        )


def _listed(numbers: NDArray[np.integer]) -> str:
    return ", ".join(map(str, np.sort(numbers)[:8].tolist()))


def _dictionary(name: str) -> Any:
    """OpenCV's dictionary of that name."""
    import cv2

    known = [word[5:] for word in dir(cv2.aruco) if word.startswith("DICT_")]
    wanted = name.upper().removeprefix("DICT_")
    match = next((word for word in known if word.upper() == wanted), None)
    if match is None:
        raise InputError(
            f"dictionary {name!r} is not known: one of "
            f"{', '.join(sorted({word.upper() for word in known}))}"
        )
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{match}"))


def _detected(
    image: NDArray[np.uint8], dictionary: str
) -> tuple[list[Any], NDArray[np.int64]]:
    """Corners of the markers seen, and their numbers."""
    import cv2

    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
    detector = cv2.aruco.ArucoDetector(_dictionary(dictionary), settings)
    corners, numbers, _ = detector.detectMarkers(image)
    if numbers is None or len(numbers) == 0:
        raise InputError(
            f"no marker of {dictionary} is seen: is the dictionary another one, or "
            "the photo blurred or dark?"
        )
    return list(corners), np.asarray(numbers).reshape(-1).astype(np.int64)


def _fitted(
    board: Board,
    corners: list[Any],
    numbers: NDArray[np.int64],
    camera: Intrinsics,
) -> MarkerPose | None:
    """The pose of a board; None where none of its markers is seen."""
    import cv2

    grid = cv2.aruco.GridBoard(
        (board.columns, board.rows),
        board.marker,
        board.gap,
        _dictionary(board.dictionary),
    )
    points, pixels = grid.matchImagePoints(corners, numbers.astype(np.int32))
    if points is None or len(points) < 4:
        return None
    of_board = set(np.asarray(grid.getIds()).reshape(-1).tolist())
    own = tuple(sorted(of_board & set(numbers.tolist())))
    # a planar set of corners has two candidate poses; the better one is refined
    _, turns, shifts, _ = cv2.solvePnPGeneric(
        points, pixels, camera.matrix, camera.distortion, flags=cv2.SOLVEPNP_IPPE
    )
    return _refined(
        own,
        np.asarray(points, np.float64).reshape(-1, 3),
        np.asarray(pixels, np.float64).reshape(-1, 2),
        camera,
        (turns[0], shifts[0]),
    )


def _refined(
    markers: tuple[int, ...],
    points: Array,
    pixels: Array,
    camera: Intrinsics,
    start: tuple[Any, Any],
) -> MarkerPose:
    """Least squares over the corners, and its covariance."""
    import cv2

    K, distortion = camera.matrix, camera.distortion
    turn, shift = cv2.solvePnPRefineLM(points, pixels, K, distortion, *start)
    projected, jacobian = cv2.projectPoints(points, turn, shift, K, distortion)
    rest = (projected.reshape(-1, 2) - pixels).reshape(-1)
    square = float(rest @ rest)
    if not np.isfinite(square):
        raise InputError("no pose explains the corners: check intrinsics")
    by_turns = np.linalg.inv(left_jacobian(np.asarray(turn, np.float64).reshape(3)))
    J = np.asarray(jacobian)[:, :6] @ by_turns
    variance = max(square / (len(rest) - 6), LEAST_PIXEL_STD**2)
    pose = homogeneous(cv2.Rodrigues(turn)[0], shift.reshape(3))
    covariance = np.asarray(variance * np.linalg.pinv(J.T @ J), np.float64)
    return MarkerPose(markers, pose, covariance, float(np.sqrt(square / len(pixels))))


def _uncertainty(found: MarkerPose) -> None:
    """Warn of a pose that fits badly or is ambiguous."""
    what = f"marker{'s' * (len(found.markers) > 1)} {_listed(np.array(found.markers))}"
    if found.residual > DOUBTFUL:
        warn(
            f"{what}: corners lie {found.residual:.2g} pixels off: "
            "check the lengths and intrinsics, or take a sharper photo",
            2,
        )
    other = found.other_residual
    if other is not None and other < UNAMBIGUOUS * found.residual:
        warn(
            f"{what}: a second pose fits nearly as well ({found.residual:.2g} and "
            f"{other:.2g} pixels): use a board, or come closer",
            2,
        )

"""From a depth image to points in the scan's frame, each with its standard deviation.

    image = read_depth_image("scan.png", read_intrinsics("camera.json"))
    cloud = image.to_cloud(camera_to_scan, noise=noise_model("structured-light"))
    surface = tt.extract_surface(cloud.points, axis=..., point_std=cloud.std)

Camera axes are OpenCV's: x to the right of the image, y down, z forward. Pixels that
show no surface, or one at a grazing angle, are left out and counted (`judge`).

Around every pixel a plane is fitted to its neighbours on the same surface. Seen by a
camera, a plane A X + B Y + C Z = 1 is 1/Z = A x + B y + C with x = X/Z and y = Y/Z:
linear in the inverse depth, whatever the rays. A neighbour is on another surface when
its depth differs by more than noise and the steepest accepted surface can explain.

A flying pixel lies between two surfaces, where the camera mixed their depths: an
adjacent pixel is on another surface, or few of its neighbours are on its own. The
outermost pixels of a surface cannot be told from mixed ones, so they count as flying.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import InputError, located
from ttus_opt.probe.pose import PoseLike
from ttus_opt.probe.rigid_motion import moved, rigid_motion
from ttus_opt.scan.cloud import of_patient
from ttus_opt.sensors.depth_bag import Frame
from ttus_opt.sensors.depth_files import read_depth
from ttus_opt.sensors.depth_noise import NoiseModel, Pixels
from ttus_opt.sensors.intrinsics import Intrinsics
from ttus_opt.sensors.unprojection import Unprojection

#: Half width of the window: wide enough to average noise, small enough that a body is
#: flat in it [m]
REACH = 0.010

#: Neighbours on either side of a pixel, in rows and in columns
STEPS = 2

#: A neighbour more standard deviations away than this is on another surface
GATE = 4.0

#: Standard deviation without a noise model, as a fraction of the depth [–]
USUAL_NOISE = 0.003

#: Least fraction of the measured neighbours, and least number, on a pixel's own surface
LEAST_SHARE, LEAST_COUNT = 0.4, 6


def judge(
    z: Array, rays: Array, focal: float, noise: Array, steepest: float
) -> tuple[Mask, Array]:
    """Fit a plane around every pixel.

    Args:
        z: Depth along the optical axis, NaN where not measured, (height, width) [m].
        rays: Unit vectors of the pixels, shape (height, width, 3) [–].
        focal: Focal length [pixel].
        noise: Standard deviation of z, same shape as it [m].
        steepest: Largest angle of incidence that is kept [rad].

    Returns:
        Which pixels are flying: between two surfaces, at the edge of one, or isolated,
        and the angle between ray and surface normal [rad], NaN where flying or not
        measured, shape (height, width) each.
    """
    x, y = rays[..., 0] / rays[..., 2], rays[..., 1] / rays[..., 2]
    stride = max(1, round(REACH * focal / float(np.nanmedian(z)) / STEPS))
    slope = np.tan(steepest) / focal
    edge = np.zeros(z.shape, dtype=bool)
    for there, here, steps in _neighbours(z.shape, 1, 1):
        room = GATE * np.sqrt(2.0) * noise[here] + steps * slope * z[here]
        edge[here] |= np.abs(z[there] - z[here]) > room  # NaN is not a neighbour
    sums = np.zeros((10, *z.shape))  # 1, x, y, w, xx, xy, yy, xw, yw, all there are
    for there, here, steps in _neighbours(z.shape, STEPS, stride):
        dz = z[there] - z[here]
        seen = np.isfinite(dz)
        room = GATE * np.sqrt(2.0) * noise[here] + steps * slope * z[here]
        near = seen & (np.abs(dz) <= room)
        dx = np.where(near, x[there] - x[here], 0.0)
        dy = np.where(near, y[there] - y[here], 0.0)
        dw = np.where(near, 1.0 / z[there] - 1.0 / z[here], 0.0)
        terms = (near, dx, dy, dw, dx * dx, dx * dy, dy * dy, dx * dw, dy * dw, seen)
        for total, term in zip(sums, terms, strict=True):
            total[here] += term
    count, present = sums[0], sums[9]
    measured = np.isfinite(z)
    alone = (count < LEAST_SHARE * present) | (count < LEAST_COUNT)
    flying = measured & (alone | edge)
    incidence = _incidence(sums, x, y, 1.0 / z)
    return flying, np.where(measured & ~flying, incidence, np.nan)


def _neighbours(
    shape: tuple[int, ...], most: int, stride: int
) -> Iterator[tuple[tuple[slice, slice], tuple[slice, slice], float]]:
    """Slices of neighbours and of their pixels, and the distance between them [pixel].

    Neighbours are up to ``most`` strides away in rows and columns, the pixel included.
    """

    def pair(step: int, side: int) -> tuple[slice, slice]:
        step = int(np.clip(step, -side, side))
        ahead, behind = slice(max(step, 0), side + min(step, 0)), max(-step, 0)
        return ahead, slice(behind, side - max(step, 0))

    for i in range(-most, most + 1):
        for j in range(-most, most + 1):
            rows, own_rows = pair(i * stride, shape[0])
            columns, own_columns = pair(j * stride, shape[1])
            distance = stride * float(np.hypot(i, j))
            yield (rows, columns), (own_rows, own_columns), distance


def _incidence(sums: Array, x: Array, y: Array, w: Array) -> Array:
    """Angle between ray and normal of the plane 1/Z = A x + B y + C [rad]."""
    n = np.maximum(sums[0], 1.0)
    mx, my, mw = sums[1] / n, sums[2] / n, sums[3] / n
    xx, xy, yy = sums[4] / n - mx**2, sums[5] / n - mx * my, sums[6] / n - my**2
    xw, yw = sums[7] / n - mx * mw, sums[8] / n - my * mw
    determinant = xx * yy - xy**2
    # neighbours on a line determine no plane
    flat = determinant > 1e-3 * (0.5 * (xx + yy)) ** 2
    with np.errstate(invalid="ignore", divide="ignore"):
        A = (yy * xw - xy * yw) / determinant
        B = (xx * yw - xy * xw) / determinant
        fitted = w + mw - A * mx - B * my  # 1/Z of the plane on the pixel's own ray
        C = fitted - A * x - B * y
        length = np.sqrt(A**2 + B**2 + C**2) * np.sqrt(x**2 + y**2 + 1.0)
        cosine = np.clip(fitted / length, 0.0, 1.0)
    return np.asarray(np.where(flat, np.arccos(cosine), np.pi / 2))


DepthKind = Literal["z", "range"]

#: Surfaces seen at a larger angle from their normal are left out [rad]
GRAZING = np.deg2rad(75.0)


@dataclass(frozen=True)
class Dropped:
    """Number of pixels left out.

    Attributes:
        invalid: Not measured, or without a ray.
        flying: Between two surfaces, at the edge of one, or isolated.
        grazing: Seen at too large an angle of incidence.
    """

    invalid: int
    flying: int
    grazing: int


@dataclass(frozen=True)
class DepthCloud:
    """Points of a scan.

    Attributes:
        points: In the scan's frame, shape (n, 3) [m].
        std: Standard deviation along the ray, shape (n,) [m]; None without a noise
            model.
        dropped: Pixels left out, one entry per image.
    """

    points: Array = field(repr=False)
    std: Array | None = field(repr=False)
    dropped: tuple[Dropped, ...]

    def of_patient(self, name: str, box: Sequence[float] | None = None) -> DepthCloud:
        """What a box or, in a room, the body that stands alone keeps of the points.

        Arguments and errors as `ttus_opt.scan.cloud.of_patient`.
        """
        kept = of_patient(self.points, name, box)
        std = None if self.std is None else self.std[kept]
        return replace(self, points=self.points[kept], std=std)


@dataclass(frozen=True)
class DepthImage:
    """Depths and the rays along which they were measured.

    Attributes:
        depth: NaN where not measured, shape (height, width) [m].
        camera: Rays of the pixels.
        depth_kind: ``z`` along the optical axis, ``range`` along the ray.
        name: Name of the image in messages.
        frame: Which image of a recording it is; None for one alone.
    """

    depth: Array = field(repr=False)
    camera: Unprojection = field(repr=False)
    depth_kind: DepthKind = "z"
    name: str = "depth image"
    frame: Frame | None = None

    def __post_init__(self) -> None:
        """Validate the image.

        Raises:
            InputError: An unknown kind, a size other than the camera's, depths that are
                not positive, or no depth at all.
        """
        if self.depth_kind not in get_args(DepthKind):
            raise InputError(
                "depth_kind must be 'z' (along the optical axis) or 'range' (along "
                f"the ray), got {self.depth_kind!r}"
            )
        if self.depth.shape != self.camera.shape:
            found, expected = self.depth.shape, self.camera.shape
            raise InputError(
                f"{self.name} has shape {found}, the camera's rays {expected}: "
                "another camera, or transposed?"
            )
        depth = self.depth[~np.isnan(self.depth)]
        if not (np.isfinite(depth) & (depth > 0.0)).all():
            raise InputError(
                f"{self.name} has depths that are not positive: set them to NaN"
            )
        if not np.isfinite(self._distance()).any():
            raise InputError(f"{self.name} has no pixel with a depth: record it again")

    def _distance(self) -> Array:
        """Distance along the rays, NaN where there is no depth or no ray [m]."""
        z = self.camera.rays[..., 2]
        along = self.depth / z if self.depth_kind == "z" else self.depth
        return np.where(np.isnan(z), np.nan, along)

    def to_cloud(
        self,
        camera_pose: PoseLike | None = None,
        *,
        noise: NoiseModel | None = None,
        grazing: float = GRAZING,
    ) -> DepthCloud:
        """The points of the image.

        Args:
            camera_pose: Camera to scan, x_scan = R x_camera + t, shape (4, 4) [–, m];
                by default points stay in the camera's frame.
            noise: Noise model of the camera (`ttus_opt.sensors.depth_noise`).
            grazing: Largest angle between ray and surface normal [rad].

        Raises:
            InputError: Not a rigid motion, an invalid angle, or no pixel shows a
                surface.
        """
        if not 0.1 < grazing < np.pi / 2:
            raise InputError(
                f"grazing must be an angle from 0.1 to 1.57 rad, got {grazing:g}: "
                "degrees?"
            )
        pose = rigid_motion(np.eye(4) if camera_pose is None else camera_pose)
        rays, focal = self.camera.rays, self.camera.focal
        distance = self._distance()
        z = distance * rays[..., 2]

        def deviation(incidence: Array) -> Array:
            if noise is None:
                return USUAL_NOISE * distance
            return noise.along_ray(Pixels(z, distance, incidence, focal))

        axial = deviation(np.zeros_like(z)) * rays[..., 2]
        flying, incidence = judge(z, rays, focal, axial, grazing)
        measured = np.isfinite(distance)
        steep = measured & (incidence > grazing)  # NaN where flying
        kept = measured & ~flying & ~steep
        dropped = Dropped(int((~measured).sum()), int(flying.sum()), int(steep.sum()))
        if not kept.any():
            raise InputError(
                f"{self.name}: no pixel shows a surface ({dropped.invalid} without "
                f"depth, {dropped.flying} flying, {dropped.grazing} grazing): check "
                "intrinsics, unit and depth kind"
            )
        points = distance[kept, None] * rays[kept]
        std = None if noise is None else deviation(incidence)[kept]
        return DepthCloud(moved(points, pose), std, (dropped,))


def read_depth_image(
    path: str | os.PathLike[str],
    camera: Intrinsics | Unprojection,
    *,
    depth_kind: DepthKind = "z",
    unit: str | None = None,
    topic: str | None = None,
    at: float | None = None,
) -> DepthImage:
    """Read a depth image.

    Args:
        path: 16-bit PNG, TIFF or NPY; whole numbers are millimetres and fractions
            metres, unless a unit is given.
        camera: Its intrinsics (`ttus_opt.sensors.intrinsics.read_intrinsics`), or a
            table of rays (`ttus_opt.sensors.unprojection.read_unprojection`).
        depth_kind: ``z`` along the optical axis, ``range`` along the ray.
        unit: ``m``, ``cm`` or ``mm``.
        topic: Of a recording (.bag), the name of its images where there are several.
        at: Of a recording, the image nearest to this time after the first [s]; by
            default the one in the middle.

    Raises:
        FileError: Missing, damaged, or not a depth image.
        InputError: Its size is not the camera's, or its unit is another.
    """
    depth, frame = read_depth(path, unit, topic=topic, at=at)
    name = os.fspath(path)
    with located(name):
        if isinstance(camera, Intrinsics):
            shape = depth.shape[0], depth.shape[1]
            camera = Unprojection.from_intrinsics(camera, shape)
        return DepthImage(depth, camera, depth_kind, name, frame)

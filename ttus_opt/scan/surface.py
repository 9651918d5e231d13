"""The patient's surface as a radius over angle and height, r = R(θ, z).

The contour filter (`ttus_opt.scan.extraction`) produces it, the voxmap consumes it, and
it is stored as netCDF. Between nodes the radius is bilinear, periodic in θ; beyond the
first and last slice it is constant in z (`ttus_opt.scan.radius_lookup`).
"""

from __future__ import annotations

import os
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core import io
from ttus_opt.core.arguments import hold_numbers
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import FileError, GeometryError, InputError
from ttus_opt.core.html_card import card, sections_svg
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.radius_lookup import RadiusLayout, radii_at

KIND, VERSION = "surface", 1

#: Radii and heights beyond this are in another unit [m]
LARGEST = 10.0

#: Off-centre of what was seen, of a single spoke's, up to which all was seen [–]
SEEN_AROUND = 0.02


@dataclass(frozen=True, eq=False)
class Surface:
    """Radius of the patient's surface on a regular (θ, z) grid.

    Attributes:
        theta: Angles, equally spaced over the full turn, shape (n_theta,) [rad].
        z: Heights, equally spaced, increasing, shape (n_z,) [m].
        radius: Radius R, shape (n_theta, n_z) [m].
        radius_std: Standard deviation of the radius, same shape [m].
        observed: False where no point was seen and the radius was filled in.
        axis: The patient frame in the scan.
    """

    theta: Array
    z: Array
    radius: Array
    radius_std: Array = field(repr=False)
    observed: NDArray[np.bool_] = field(repr=False)
    axis: Axis

    def __post_init__(self) -> None:
        """Validate the surface.

        Raises:
            InputError: What is no array of numbers, shapes that disagree, or steps that
                are not constant.
            GeometryError: A radius that is not finite and positive.
        """
        hold_numbers(self, "surface", "theta", "z", "radius", "radius_std")
        shape = (len(self.theta), len(self.z))
        if min(shape) < 2 or shape[0] < 4:
            raise InputError(
                f"a surface needs at least 4 angles and 2 slices, got {shape}"
            )
        for name in ("radius", "radius_std", "observed"):
            given = getattr(self, name).shape
            if given != shape:
                raise InputError(
                    f"{name} must have shape (n_theta, n_z) = {shape}, got {given}: "
                    "transposed?"
                )
        step = 2.0 * np.pi / shape[0]
        if not np.allclose(np.diff(self.theta), step, atol=1e-6 * step):
            raise InputError(
                f"theta must be {shape[0]} equal steps of {step:.4g} rad over the full "
                "turn: resample the surface"
            )
        dz = np.diff(self.z)
        if dz.min() <= 0 or np.ptp(dz) > 1e-5 * dz.mean():
            raise InputError("z must increase in equal steps [m]: resample the surface")
        for name in ("radius", "z"):
            most = float(np.abs(getattr(self, name)).max())
            if LARGEST < most < np.inf:
                raise InputError(
                    f"{name} reaches {most:.4g} m: is it in millimetres? Divide by 1000"
                )
        if not ((self.radius_std >= 0) & (self.radius_std <= LARGEST)).all():
            raise InputError(
                f"radius_std must lie between 0 and {LARGEST:g} m everywhere: give 0 "
                "where it is unknown"
            )
        bad = ~(np.isfinite(self.radius) & (self.radius > 0))
        if bad.any():
            raise GeometryError(
                f"{int(bad.sum())} of {bad.size} surface radii are not positive and "
                "finite: fill or drop them first"
            )

    @classmethod
    def from_radius(
        cls, radius: Array, z: Array, *, axis: Axis | None = None
    ) -> Surface:
        """A surface known exactly: zero deviation, observed everywhere.

        Args:
            radius: Shape (n_theta, n_z) [m]; angles start at 0.
            z: Heights, shape (n_z,) [m].
            axis: Patient frame in the scan; the scan's own frame when not given.
        """
        radius = np.asarray(radius, dtype=float)
        if radius.ndim != 2:
            raise InputError(
                f"radius must have shape (n_theta, n_z), got {radius.shape}"
            )
        theta = np.arange(len(radius), dtype=np.float64)
        theta *= 2.0 * np.pi / max(len(radius), 1)
        return cls(
            theta,
            np.asarray(z, dtype=float),
            radius,
            np.zeros_like(radius),
            np.ones(radius.shape, dtype=bool),
            axis or Axis.identity(),
        )

    def raised(self, height: float) -> Surface:
        """The surface farther from the axis by a height everywhere [m]."""
        return replace(self, radius=self.radius + height)

    @property
    def kernel_layout(self) -> RadiusLayout:
        """Positions of the nodes, for compiled kernels."""
        return RadiusLayout(
            float(self.theta[0] % TURN),
            len(self.theta) / TURN,
            float(self.z[0]),
            float((len(self.z) - 1) / (self.z[-1] - self.z[0])),
        )

    def radius_at(self, theta: Array, z: Array) -> Array:
        """Bilinear radius at given places.

        Args:
            theta: Angles, any shape [rad].
            z: Heights, broadcast with ``theta`` [m].

        Returns:
            Radii, the broadcast shape [m].
        """
        theta, z = np.broadcast_arrays(np.asarray(theta, float), np.asarray(z, float))
        flat = radii_at(
            (theta % TURN % TURN).reshape(-1),  # −1e-17 % 2π rounds up to 2π itself
            np.ascontiguousarray(z).reshape(-1),
            np.ascontiguousarray(self.radius),
            self.kernel_layout,
        )
        return np.asarray(flat).reshape(theta.shape)

    def depth_of(self, points: Array) -> Array:
        """R(θ, z) − r of points (…, 3) [m]: how deep they are, shape (…) [m]."""
        x, y, z = np.moveaxis(points, -1, 0)
        return np.asarray(self.radius_at(np.arctan2(y, x), z) - np.hypot(x, y))

    def seen_at(self, theta: Array, z: Array) -> NDArray[np.bool_]:
        """Whether the scan saw the skin at the nodes nearest to places, shape (k,).

        Args:
            theta: Angles, shape (k,) [rad].
            z: Heights, shape (k,) [m].
        """
        step = TURN / len(self.theta)
        i = np.rint((theta - self.theta[0]) / step).astype(np.int64) % len(self.theta)
        j = np.abs(self.z - np.asarray(z)[:, None]).argmin(axis=1)
        return np.asarray(self.observed[i, j])

    @property
    def front(self) -> Array:
        """Direction from the axis to the middle of what was seen, or +y, shape (3,)."""
        share = self.observed.mean(axis=1)
        x, y = share @ np.cos(self.theta), share @ np.sin(self.theta)
        size = float(np.hypot(x, y))
        around = size <= SEEN_AROUND * len(share)
        return np.array([0.0, 1.0, 0.0] if around else [x / size, y / size, 0.0])

    def points(self) -> Array:
        """Nodes in the patient frame, shape (n_theta, n_z, 3) [m]."""
        x = self.radius * np.cos(self.theta)[:, None]
        y = self.radius * np.sin(self.theta)[:, None]
        return np.stack([x, y, np.broadcast_to(self.z, x.shape)], axis=-1)

    def __repr__(self) -> str:
        return f"Surface({', '.join(self._facts().values())})"

    def _repr_html_(self) -> str:
        heights = sorted({0, len(self.z) // 2, len(self.z) - 1})
        sections = self.points()[:, heights, :2].transpose(1, 0, 2)
        return card("Surface", self._facts(), sections_svg(sections))

    def _facts(self) -> dict[str, str]:
        """A short description, by name."""
        low, high = 100 * self.radius.min(), 100 * self.radius.max()
        return {
            "nodes": f"{len(self.theta)} θ × {len(self.z)} z",
            "radius": f"R {low:.1f} to {high:.1f} cm",
            "height": f"z {100 * self.z[0]:.1f} to {100 * self.z[-1]:.1f} cm",
            "observed": f"{100 * self.observed.mean():.0f} % observed",
        }

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the surface as netCDF, replacing ``path`` only on success."""
        import xarray as xr

        dims = ("theta", "z")
        dataset = xr.Dataset(
            {
                "radius": (dims, self.radius, {"units": "m"}),
                "radius_std": (dims, self.radius_std, {"units": "m"}),
                "observed": (dims, self.observed.astype("i1"), {"units": "1"}),
            },
            coords={
                "theta": ("theta", self.theta, {"units": "rad"}),
                "z": ("z", self.z, {"units": "m"}),
            },
            attrs=self.axis.attributes(),
        )
        io.write_dataset(dataset, path, kind=KIND, version=VERSION)

    @classmethod
    def load(cls, path: str | os.PathLike[str]) -> Surface:
        """Read a surface file, ours or one from elsewhere with ``radius(theta, z)``.

        Raises:
            FileError: Not netCDF, another kind or version, or no usable radius.
        """
        found = io.read_content(path, kind=KIND, version=VERSION, foreign=True)
        given, dims = found.variables, ("theta", "z")
        if "radius" not in given or set(given["radius"].dims) != set(dims):
            raise FileError(
                f"{path} has no variable radius(theta, z): not a surface file"
            )
        for name in ("radius", "radius_std", "z"):
            attributes = given[name].attrs if name in given else {}
            # only the radius must state its unit; none may state another one
            units = attributes.get("units", None if name == "radius" else "m")
            if units != "m":
                raise FileError(
                    f"{path}: {name} has units {units!r}, expected 'm': convert it and "
                    "state the unit"
                )

        def numbers(name: str, dims: tuple[str, ...]) -> Array:
            """A variable over dimensions that the file may have in another order."""
            if name not in given or set(given[name].dims) != set(dims):
                raise InputError(f"it has no variable {name}({', '.join(dims)})")
            values = io.as_numbers(name, given[name].values)
            return values.transpose([given[name].dims.index(dim) for dim in dims])

        try:
            theta, z = (numbers(dim, (dim,)) for dim in dims)
            order = np.ix_(np.argsort(theta), np.argsort(z))
            radius, std = numbers("radius", dims), np.zeros((len(theta), len(z)))
            if "radius_std" in given:
                std = numbers("radius_std", dims)
            observed = np.ones(radius.shape)
            if "observed" in given:
                observed = numbers("observed", dims)
            return cls(
                np.sort(theta),
                np.sort(z),
                radius[order],
                std[order],
                io.mask("observed", observed[order]),
                Axis.from_attributes(found.attrs),
            )
        except (InputError, IndexError, TypeError, ValueError) as error:
            raise FileError(f"{path}: {error}") from error

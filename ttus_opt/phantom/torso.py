"""A torso of soft tissue with ribs and a stiff lump, fixed at its core and back.

Cross-sections are superellipses whose size varies along z. The tissue's stiffness is a
smooth function of position and so does not depend on the mesh, of hexahedra in closed
rings with graded node positions. A `ScannedTorso` has the tissue of `Torso` below a
scanned surface.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any

import numpy as np
from scipy.interpolate import RectBivariateSpline
from scipy.ndimage import gaussian_filter1d

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.core.optional import load
from ttus_opt.phantom.elasticity import ElasticBody
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import Surface


def graded(
    low: float,
    high: float,
    fine: tuple[float, float],
    step: float,
    growth: float = 1.35,
    largest: float = np.inf,
) -> Array:
    """Node positions with even steps within ``fine`` that grow towards both ends.

    Args:
        low: First node.
        high: Last node.
        fine: Interval of even steps, within [low, high].
        step: Step in ``fine``, rounded so that it divides the interval.
        growth: Ratio of neighbouring steps outside, above 1.
        largest: Largest step outside.

    Returns:
        Increasing positions, shape (n,), in the unit of the arguments.

    Raises:
        InputError: The limits are out of order, or step or growth give no mesh.

    Examples:
        >>> graded(0.0, 10.0, (0.0, 2.0), 1.0, growth=2.0).round(3).tolist()
        [0.0, 1.0, 2.0, 4.667, 10.0]
    """
    if not (low <= fine[0] < fine[1] <= high) or step <= 0.0 or growth <= 1.0:
        raise InputError(
            f"cannot grade [{low}, {high}] with {fine} fine at step {step} and growth "
            f"{growth}: expected low <= fine[0] < fine[1] <= high, step > 0, growth > 1"
        )
    n_fine = max(round((fine[1] - fine[0]) / step), 1)
    middle = np.linspace(*fine, n_fine + 1)
    below = _growing(fine[0] - low, step, growth, largest)
    above = _growing(high - fine[1], step, growth, largest)
    nodes = np.concatenate([fine[0] - below[::-1], middle, fine[1] + above])
    nodes[[0, -1]] = low, high  # exact: boundary conditions compare with them
    return nodes


def _growing(length: float, step: float, growth: float, largest: float) -> Array:
    """Positions after growing steps that add up to ``length``, without the zero."""
    if length < 1e-9 * step:
        return np.empty(0)
    steps = [min(step * growth, largest)]
    while sum(steps) < length - 0.5 * steps[-1]:
        steps.append(min(steps[-1] * growth, largest))
    positions = np.cumsum(steps)
    return np.asarray(positions * (length / positions[-1]))


def ring_mesh(fraction: Array, theta: Array, z: Array, points: Any) -> Any:
    """Hexahedra around an axis that close to a ring.

    Args:
        fraction: Radial coordinate of the nodes, increasing, shape (n_r,) [–].
        theta: Angles of one full turn with both ends, shape (n_theta + 1,) [rad].
        z: Heights, shape (n_z,) [m].
        points: Maps (fraction, θ, z), each (n,), to points (n, 3) [m].

    Returns:
        A `skfem.MeshHex` whose nodes are in C order of (n_r, n_theta, n_z).

    Raises:
        InputError: The angles do not span one full turn.
    """
    MeshHex = load("skfem", "phantom").MeshHex
    if abs(theta[-1] - theta[0] - 2.0 * np.pi) > 1e-9:
        raise InputError(
            f"theta must span one full turn, got {theta[-1] - theta[0]:.6g} rad"
        )
    # A box in index space gives the connectivity; its last angle is the first one.
    indices = [np.arange(float(len(v))) for v in (fraction, theta, z)]
    box = MeshHex.init_tensor(*indices)
    i, j, k = np.rint(box.p).astype(int)
    n_theta, n_z = len(theta) - 1, len(z)
    number = (i * n_theta + j % n_theta) * n_z + k
    grid = np.meshgrid(fraction, theta[:-1], z, indexing="ij")
    nodes = points(*(axis.reshape(-1) for axis in grid))
    return MeshHex(np.ascontiguousarray(nodes.T), np.ascontiguousarray(number[box.t]))


@dataclass(frozen=True)
class Torso:
    """Shape and tissue; patient frame, y towards the front, z along the body.

    Attributes:
        half_axes: Semi-axes of the mean cross-section along x and y [m].
        exponent: Exponent of the superellipse; 2 is an ellipse [–].
        swell: Relative amplitude of the cross-section's size along z [–].
        length: Extent along z, from 0 [m].
        core_radius: Radius of the rigid inner core [m].
        back_height: The table fixes skin below this y [m].
        soft: Young's modulus of the soft tissue [Pa].
        rib: Young's modulus of the ribs [Pa].
        lump: Young's modulus of the lump [Pa].
        poisson: Poisson's ratio of all tissue [–].
        rib_pitch: Distance between ribs along z [m].
        rib_width: Width of a rib along z [m].
        rib_depth: Depths below the skin between which the ribs lie [m].
        rib_from: Lowest z of the ribs at the front [m].
        lump_centre: Centre of the lump [m].
        lump_radius: Radius of the lump [m].
    """

    half_axes: tuple[float, float] = (0.160, 0.115)
    exponent: float = 2.3
    swell: float = 0.04
    length: float = 0.30
    core_radius: float = 0.035
    back_height: float = -0.105
    soft: float = 20e3
    rib: float = 200e3
    lump: float = 120e3
    poisson: float = 0.45
    rib_pitch: float = 0.034
    rib_width: float = 0.012
    rib_depth: tuple[float, float] = (0.012, 0.022)
    rib_from: float = 0.14
    lump_centre: tuple[float, float, float] = (0.012, 0.093, 0.105)
    lump_radius: float = 0.012

    def radius(self, theta: Array, z: Array) -> Array:
        """Radius of the skin [m] at angles [rad] and heights [m], broadcast."""
        a, b = self.half_axes
        p = self.exponent
        rim = np.abs(np.cos(theta) / a) ** p + np.abs(np.sin(theta) / b) ** p
        scale = 1.0 + self.swell * np.cos(2.0 * np.pi * (z - 0.21) / 0.36)
        return np.asarray(scale * rim ** (-1.0 / p))

    def skin(self, theta: Array, z: Array) -> Array:
        """Points of the skin, shape (..., 3) [m]."""
        theta, z = np.broadcast_arrays(theta, z)
        r = self.radius(theta, z)
        return np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)

    def surface(self, n_theta: int, n_z: int, axis: Axis | None = None) -> Surface:
        """The skin on a grid of nodes; the axis is that of a scan."""
        theta = np.linspace(0.0, 2.0 * np.pi, n_theta, endpoint=False)
        z = np.linspace(0.0, self.length, n_z)
        return Surface.from_radius(self.radius(theta[:, None], z), z, axis=axis)

    def normals(self, theta: Array, z: Array) -> Array:
        """Outward unit normals of the skin, shape (..., 3) [–]."""
        h = 1e-5  # central differences of a smooth function: error about 1e-9
        around = self.skin(theta + h, z) - self.skin(theta - h, z)
        along = self.skin(theta, z + h) - self.skin(theta, z - h)
        normal = np.cross(around, along)
        return np.asarray(normal / np.linalg.norm(normal, axis=-1, keepdims=True))

    def young(self, points: Array) -> Array:
        """Young's modulus [Pa] at points of shape (3, ...) [m], shape (...)."""
        x, y, z = points
        theta = np.arctan2(y, x)
        depth = self.radius(theta, z) - np.hypot(x, y)
        # ribs slope down towards the sides
        height = z + 0.03 * np.abs(np.sin(theta - np.pi / 2)) - self.rib_from
        off = np.abs((height / self.rib_pitch) % 1.0 - 0.5) * self.rib_pitch
        rib = (
            _inside(off - self.rib_width / 2)
            * _inside(self.rib_depth[0] - depth)
            * _inside(depth - self.rib_depth[1])
            * _inside(-height)
            * _inside(self.back_height - y)
        )
        centre = np.asarray(self.lump_centre).reshape((3,) + (1,) * (points.ndim - 1))
        away = np.sqrt(((points - centre) ** 2).sum(axis=0))
        lump = _inside(away - self.lump_radius)
        return np.asarray(
            self.soft + (self.rib - self.soft) * rib + (self.lump - self.soft) * lump
        )


def _inside(distance: Array) -> Array:
    """1 inside (negative distance), 0 outside, with a smooth step of about 1 mm."""
    return np.asarray(0.5 * (1.0 - np.tanh(distance / 1e-3)))


@dataclass(frozen=True)
class TorsoMesh:
    """Resolution of a torso's mesh, and the patch of skin that may be pressed.

    Attributes:
        resolution: Factor on every node spacing; 1 in the example, 2 is coarse [–].
        theta: Range of the patch's angles [rad].
        z: Range of the patch's z [m].
        pitch: Node spacing in the patch: into, around and along the body [m].
    """

    resolution: float = 1.0
    theta: tuple[float, float] = (np.radians(65.0), np.radians(115.0))
    z: tuple[float, float] = (0.070, 0.230)
    pitch: tuple[float, float, float] = (0.0035, 0.004, 0.003)


def torso_body(torso: Torso, mesh: TorsoMesh | None = None) -> ElasticBody:
    """Mesh a torso.

    Args:
        torso: Shape and tissue.
        mesh: Spacing and patch; by default those of the example.

    Returns:
        The body. Its core is fixed, and its back where it lies on the table; both ends
        slide in their planes, as if the body continued.

    Raises:
        GeometryError: The core reaches the skin.
    """
    spec = mesh or TorsoMesh()
    into, around, along = (spec.resolution * p for p in spec.pitch)
    front = float(torso.radius(np.array(np.pi / 2), np.array(sum(spec.z) / 2)))
    if torso.core_radius >= 0.8 * min(torso.half_axes):
        raise GeometryError(
            f"core_radius {torso.core_radius} m leaves no tissue below a skin at "
            f"{min(torso.half_axes)} m: make it smaller"
        )
    thick = front - torso.core_radius
    fraction = graded(0.0, 1.0, (1.0 - 7e-3 / thick, 1.0), into / thick, growth=1.4)
    middle = sum(spec.theta) / 2
    theta = graded(
        middle - np.pi,
        middle + np.pi,
        spec.theta,
        around / front,
        growth=1.5,
        largest=0.4,
    )
    z = graded(0.0, torso.length, spec.z, along, growth=1.5, largest=0.03)

    def place(f: Array, angle: Array, height: Array) -> Array:
        core = torso.core_radius
        r = core + f * (torso.radius(angle, height) - core)
        return np.stack([r * np.cos(angle), r * np.sin(angle), height], axis=-1)

    hexahedra = ring_mesh(fraction, theta, z, place)
    layers = np.meshgrid(fraction, theta[:-1], z, indexing="ij")
    f, angle, height = (layer.reshape(-1) for layer in layers)
    held = (f == 0.0) | ((f == 1.0) & (hexahedra.p[1] < torso.back_height))
    fixed = np.repeat(held[:, None], 3, axis=1)
    fixed[:, 2] |= (height == 0.0) | (height == torso.length)
    tiny = 1e-9
    patch = np.flatnonzero(
        (f == 1.0)
        & (np.abs(angle - middle) < (spec.theta[1] - spec.theta[0]) / 2 + tiny)
        & (height > spec.z[0] - tiny)
        & (height < spec.z[1] + tiny)
    )
    angle, height = angle[patch], height[patch]
    rim = np.zeros(len(patch), dtype=bool)
    for value in (angle, height):
        rim |= (value < value.min() + tiny) | (value > value.max() - tiny)
    normals = torso.normals(angle, height)
    return ElasticBody(
        hexahedra, torso.young, torso.poisson, fixed, patch, normals, rim
    )


#: Angles repeated beyond both ends of the turn, so that the spline is periodic
OVERLAP = 24


@dataclass(frozen=True)
class ScannedTorso(Torso):
    """A `Torso` whose skin is a scanned surface; z runs from 0 to ``length``.

    ``half_axes`` are those of the scan; ``exponent`` and ``swell`` are not used.

    Attributes:
        scanned: The surface; its lowest slice is the torso's z = 0.
        harmonics: Number of harmonics of the radius around the body to keep [–].
        smoothing: Standard deviation of the Gaussian that smooths along z [m].
    """

    scanned: Surface | None = field(default=None, repr=False)
    harmonics: int = 16
    smoothing: float = 0.006

    @classmethod
    def of(cls, surface: Surface, tissue: Torso) -> ScannedTorso:
        """Put the ribs, lump and moduli of another torso below a scanned surface.

        Raises:
            GeometryError: The surface is shorter than that torso.
        """
        length = float(surface.z[-1] - surface.z[0])
        if length < tissue.length:
            raise GeometryError(
                f"the scan is {length:.3f} m long, the torso {tissue.length:.3f} m: "
                "give a shorter torso or a longer scan"
            )
        quarter = len(surface.theta) // 4
        x = float(surface.radius[[0, 2 * quarter]].mean())
        y = float(surface.radius[[quarter, 3 * quarter]].mean())
        given = {f.name: getattr(tissue, f.name) for f in fields(Torso)}
        return cls(**{**given, "half_axes": (x, y), "scanned": surface})

    def radius(self, theta: Array, z: Array) -> Array:
        """Radius of the skin [m] at angles [rad] and heights [m], broadcast."""
        theta, z = np.broadcast_arrays(np.asarray(theta, float), np.asarray(z, float))
        return np.asarray(self._spline.ev(theta % TURN, z))

    @cached_property
    def _spline(self) -> RectBivariateSpline:
        """Twice differentiable interpolation of the smoothed radius."""
        if self.scanned is None:
            raise InputError("no surface was given: make it by ScannedTorso.of")
        theta, z = self.scanned.theta, self.scanned.z - self.scanned.z[0]
        waves = np.fft.rfft(self.scanned.radius, axis=0)
        waves[self.harmonics + 1 :] = 0.0
        radius = np.fft.irfft(waves, len(theta), axis=0)
        radius = gaussian_filter1d(
            radius, self.smoothing / (z[1] - z[0]), axis=1, mode="nearest"
        )
        around = [theta[-OVERLAP:] - TURN, theta, theta[:OVERLAP] + TURN]
        turned = [radius[-OVERLAP:], radius, radius[:OVERLAP]]
        return RectBivariateSpline(np.concatenate(around), z, np.concatenate(turned))

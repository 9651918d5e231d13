"""A surface as a message, whole or as changes since an earlier one.

A message holds the radii within an error bound, the observed mask, the grid, the
patient frame and two standard deviations, the medians where the surface was observed
and where it was filled in. A decoded surface has these two in ``radius_std``.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.message.envelope import (
    SURFACE,
    SURFACE_DELTA,
    Reader,
    Writer,
    read_integers,
    write_integers,
)
from ttus_opt.message.interpolation import Scheme, differences, restored
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import LARGEST, Surface

#: Default bound of the radius [m]
MAX_ERROR = 0.25e-3

#: Accepted range of bounds [m]
LEAST_BOUND, GREATEST_BOUND = 1e-6, 1.0

#: Most nodes of a surface: 720 × 1,440
MOST_NODES = 2**20

#: Tolerance of equal angles, heights and frames [rad, m, 1]
SAME = 1e-9


class Window(NamedTuple):
    """A rectangle of nodes, given by first index and count; angles wrap."""

    theta: int
    n_theta: int
    z: int
    n_z: int

    def indices(self, shape: tuple[int, ...]) -> tuple[NDArray[np.int64], ...]:
        """Indices along both axes, for ``array[…]``."""
        return np.ix_(
            (self.theta + np.arange(self.n_theta)) % shape[0],
            self.z + np.arange(self.n_z),
        )

    @classmethod
    def around(cls, changed: Mask) -> Window:
        """The smallest window with all marked nodes; one node without any."""
        heights = np.flatnonzero(changed.any(axis=0))
        angles = np.flatnonzero(changed.any(axis=1))
        if len(angles) == 0:
            return cls(0, 1, 0, 1)
        # the window leaves out the widest gap on the circle
        gaps = np.diff(angles, append=angles[0] + len(changed))
        widest = len(gaps) - 1 - int(gaps[::-1].argmax())  # the last of equal ones
        first = int(angles[(widest + 1) % len(angles)])
        count = len(changed) - int(gaps[widest]) + 1
        return cls(first, count, int(heights[0]), int(np.ptp(heights)) + 1)


def _scheme(n_theta: int, n_z: int, *, closed: bool) -> Scheme:
    """Heights first: angles are closer and better predicted."""
    return Scheme((n_theta, n_z), (closed, False), (1, 0))


def check_bound(max_error: float, least: float, greatest: float, unit: str) -> float:
    """Validate an error bound; `InputError` where it is out of range."""
    if not least <= max_error <= greatest:
        raise InputError(
            f"max_error must lie between {least:g} and {greatest:g} {unit}, got "
            f"{max_error}"
        )
    return float(max_error)


def encode_surface(surface: Surface, max_error: float = MAX_ERROR) -> bytes:
    """A whole surface as a message, radii within ``max_error`` [m].

    Raises:
        InputError: An invalid bound, or too many nodes.
    """
    bound = check_bound(max_error, LEAST_BOUND, GREATEST_BOUND, "m")
    n_theta, n_z = surface.radius.shape
    _check_counts(n_theta, n_z)
    writer = Writer()
    writer.number("HH", n_theta, n_z)
    writer.number("3d", surface.theta[0], surface.z[0], surface.z[-1])
    writer.number("3d", *surface.axis.origin)
    writer.number("4d", *Rotation.from_matrix(surface.axis.rotation).as_quat())
    _write_nodes(writer, surface, surface.radius, surface.observed, bound)
    return writer.message(SURFACE)


def decode_surface(reader: Reader) -> Surface:
    """The surface of a message.

    Raises:
        InputError: The message is damaged or hostile.
    """
    n_theta, n_z = reader.numbers("HH")
    _check_counts(n_theta, n_z)
    theta, low, high = reader.numbers("3d")
    origin, quaternion = np.array(reader.numbers("3d")), np.array(reader.numbers("4d"))
    limits = np.array([theta, low, high, *origin, *quaternion])
    if not (np.isfinite(limits).all() and np.abs(limits).max() < 1e6):
        raise InputError("the message's grid or frame is not finite: ask for it again")
    if not math.isclose(float(np.linalg.norm(quaternion)), 1.0, abs_tol=1e-6):
        raise InputError("the message holds no valid rotation: ask for it again")
    nodes = _read_nodes(reader, n_theta, n_z, closed=True)
    reader.end()
    return Surface(
        theta + np.arange(n_theta) * (TURN / n_theta),
        np.linspace(low, high, n_z),
        nodes.radius,
        nodes.radius_std,
        nodes.observed,
        Axis(origin, Rotation.from_quat(quaternion).as_matrix()),
    )


def encode_surface_delta(
    surface: Surface, base: Surface, base_name: int, max_error: float = MAX_ERROR
) -> bytes:
    """Changes since a message that the receiver has.

    Only a window is sent, outside of which the receiver's surface is within the bound.

    Args:
        surface: The current surface.
        base: The receiver's surface.
        base_name: Name of the receiver's last message.
        max_error: Largest error of a radius [m].

    Raises:
        InputError: An invalid bound, or another grid or frame.
    """
    bound = check_bound(max_error, LEAST_BOUND, GREATEST_BOUND, "m")
    _check_same_grid(surface, base)
    rest = surface.radius - base.radius
    differs = surface.observed != base.observed
    window = Window.around((np.abs(rest) > bound) | differs)
    inside = window.indices(rest.shape)
    writer = Writer()
    writer.number("I", base_name)
    writer.number("4H", *window)
    _write_nodes(writer, surface, rest[inside], differs[inside], bound)
    return writer.message(SURFACE_DELTA)


def decode_surface_delta(reader: Reader, base: Surface, base_name: int) -> Surface:
    """A surface with the changes of a message.

    Args:
        reader: The message.
        base: The surface it changes.
        base_name: Name of the surface's message.

    Raises:
        InputError: It changes another surface, or is damaged or hostile.
    """
    check_base(reader.number("I"), base_name)
    window = Window(*reader.numbers("4H"))
    n_theta, n_z = base.radius.shape
    fits = window.theta < n_theta and window.z + window.n_z <= n_z
    if not (fits and 1 <= window.n_theta <= n_theta and window.n_z >= 1):
        raise InputError(
            f"the message changes nodes beyond {n_theta} x {n_z}: ask for it again"
        )
    inside = window.indices(base.radius.shape)
    nodes = _read_nodes(
        reader, window.n_theta, window.n_z, closed=window.n_theta == n_theta
    )
    reader.end()
    radius, observed = base.radius.copy(), base.observed.copy()
    radius[inside] += nodes.radius
    observed[inside] ^= nodes.observed
    std = np.where(observed, nodes.std_observed, nodes.std_filled)
    return replace(base, radius=radius, observed=observed, radius_std=std)


def check_base(wanted: int, given: int) -> None:
    """Refuse a base other than the one a message builds on."""
    if wanted != given:
        raise InputError(
            f"the message builds on message {wanted:08x}, got {given:08x} as base: "
            "give that one, or ask for a whole message"
        )


@dataclass(frozen=True)
class _Nodes:
    """Radii or changes, mask, and standard deviations."""

    radius: Array
    observed: Mask
    std_observed: float
    std_filled: float

    @property
    def radius_std(self) -> Array:
        """Per node [m]."""
        return np.where(self.observed, self.std_observed, self.std_filled)


def _write_nodes(
    writer: Writer, surface: Surface, values: Array, mask: Mask, bound: float
) -> None:
    """Append values (n_theta, n_z) [m] and a mask of the same shape."""
    closed = len(values) == len(surface.theta)
    scheme = _scheme(*values.shape, closed=closed)
    try:
        passes, _ = differences(values, bound, scheme)
    except OverflowError as error:
        raise InputError(
            f"max_error {bound:g} m is too small for radii of "
            f"{np.abs(values).max():.3g} m: choose a larger one"
        ) from error
    seen = surface.observed
    for part in (seen, ~seen):
        writer.number("f", np.median(surface.radius_std[part]) if part.any() else 0.0)
    writer.number("d", bound)
    writer.packed(np.packbits(mask).tobytes())
    # the last pass is half of all numbers and nearly zero: it compresses best alone
    write_integers(writer, np.concatenate([*passes[:-1], passes[-1][:0]]))
    write_integers(writer, passes[-1])


def _read_nodes(reader: Reader, n_theta: int, n_z: int, *, closed: bool) -> _Nodes:
    """What `_write_nodes` appended."""
    stds = reader.numbers("2f")
    bound = check_bound(reader.number("d"), LEAST_BOUND, GREATEST_BOUND, "m")
    if not all(0.0 <= std <= LARGEST for std in stds):
        raise InputError(
            "the message's standard deviations are invalid: ask for it again"
        )
    size = n_theta * n_z
    bits = np.frombuffer(reader.unpacked((size + 7) // 8), np.uint8)
    if len(bits) != (size + 7) // 8:
        raise InputError("the message is damaged: its mask has the wrong length")
    mask = np.unpackbits(bits, count=size).astype(bool).reshape(n_theta, n_z)
    scheme = _scheme(n_theta, n_z, closed=closed)
    last = math.prod(len(indices) for indices in [*scheme.passes()][-1].target)
    sent = [read_integers(reader, count) for count in (size - last, last)]
    values = restored(np.concatenate(sent), bound, scheme)
    return _Nodes(values, mask, *stds)


def _check_counts(n_theta: int, n_z: int) -> None:
    few, many = n_theta < 4 or n_z < 2, n_theta * n_z > MOST_NODES
    if few or many or max(n_theta, n_z) > 2**15:
        raise InputError(
            f"a message takes surfaces of at least 4 x 2 and at most {MOST_NODES:,} "
            f"nodes, got {n_theta} x {n_z}: extract it with fewer spokes or slices"
        )


def _check_same_grid(surface: Surface, base: Surface) -> None:
    pairs = [
        (getattr(of, name), getattr(to, name))
        for of, to, names in (
            (surface, base, ("theta", "z")),
            (surface.axis, base.axis, ("origin", "rotation")),
        )
        for name in names
    ]
    if not all(a.shape == b.shape and np.allclose(a, b, 0.0, SAME) for a, b in pairs):
        raise InputError(
            "the surface has another grid or patient frame than its base: encode it "
            "whole, or extract it on the same axis, spokes and slices"
        )

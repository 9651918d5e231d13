"""A sector of θ: two angles, and whether the surface was seen between them.

An organ, or a belly seen from the front, needs no back: a grid over the seen sector
does not depend on the unseen surface. Nothing flows through its sides, as if the body
continued beyond each as its mirror image.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.probe.cylindrical import TURN
from ttus_opt.scan.surface import Surface

#: From and to [rad]
Sector = tuple[float, float]

#: The narrowest sector: about 10 mm on a body, less than a probe's width, where
#: multigrid still converges with as many spokes as a full turn has [rad]
NARROWEST = math.radians(5.0)


def checked_sector(sector: Sector | None) -> Sector | None:
    """The sector, validated.

    Raises:
        InputError: Not two finite angles, not less than a full turn, or too narrow.
    """
    if sector is None:
        return None
    if len(sector) != 2 or not all(abs(v) <= 2.0 * TURN for v in sector):
        with np.errstate(over="ignore"):  # infinity is shown as such
            got = " to ".join(f"{v:.4g}°" for v in np.degrees(sector[:3]))
        raise InputError(
            f"a sector is two angles between -720° and 720°, got {got or 'none'}"
        )
    low, high = float(sector[0]), float(sector[1])
    if not 0.0 < high - low < TURN:
        raise InputError(
            "a sector goes from an angle to a larger one, by less than a full turn, "
            f"got {in_degrees(sector)}: across 0° write -60,60, for the whole leave it "
            "out"
        )
    if high - low < NARROWEST * (1.0 - 1e-9):
        raise InputError(
            f"a sector of {math.degrees(high - low):.4g}° is less than the width of a "
            f"probe: give at least {math.degrees(NARROWEST):g}°"
        )
    return low, high


def in_degrees(sector: Sector) -> str:
    """A sector in degrees, as text.

    >>> in_degrees((0.0, 3.14159265))
    '0° to 180°'
    """
    low, high = np.degrees(sector)
    return f"{low:.4g}° to {high:.4g}°"


def holds(sector: Sector, theta: Array) -> NDArray[np.bool_]:
    """Whether angles lie in a sector, any shape [rad]."""
    low, high = sector
    return np.asarray((np.asarray(theta) - low) % TURN <= high - low)


def check_seen(surface: Surface, sector: Sector | None) -> None:
    """Refuse a sector with angles at which the scan saw nothing.

    A hole at some heights of an angle is filled, as in the full turn.

    Raises:
        InputError: There are such angles.
    """
    if sector is None:
        return
    inside = holds(sector, surface.theta)
    seen = np.asarray(surface.observed.any(axis=1))
    unseen = int((inside & ~seen).sum())
    if unseen:
        known = _longest(seen, surface.theta)
        part = "" if known is None else in_degrees(known)
        advice = f"choose one within {part}" if part else "scan it"
        raise InputError(
            f"the scan saw no skin at {unseen} of {int(inside.sum())} angles of the "
            f"sector {in_degrees(sector)}: {advice}"
        )


def largest_radius(surface: Surface, sector: Sector | None) -> float:
    """The largest radius of the surface in a sector, or all around [m]."""
    if sector is None:
        return float(surface.radius.max())
    nodes = surface.theta[holds(sector, surface.theta)]
    angles = np.concatenate([sector, nodes])
    return float(surface.radius_at(angles[:, None], surface.z).max())


def _longest(seen: NDArray[np.bool_], theta: Array) -> Sector | None:
    """The longest run of seen angles around the circle; None without any."""
    if not seen.any():
        return None
    n = len(seen)
    gaps = np.flatnonzero(~seen)
    runs = np.diff(gaps, append=gaps[0] + n) - 1
    first = int(gaps[runs.argmax()]) + 1
    step = TURN / n
    low = float(theta[0]) + step * (first % n)
    return low, low + step * (int(runs.max()) - 1)

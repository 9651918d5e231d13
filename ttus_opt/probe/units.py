"""Units of recordings by their many spellings, as factors to SI."""

from __future__ import annotations

import math

#: Factor from a unit to SI, by quantity
UNITS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "position": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": 4.4482216152605, "kgf": 9.80665},
    "torque": {
        "N m": 1.0,
        "N mm": 1e-3,
        "N cm": 1e-2,
        "mN m": 1e-3,
        "lbf in": 0.1129848290276167,
        "lbf ft": 1.3558179483314004,
    },
    "quaternion": {"1": 1.0},
    "rotation vector": {"rad": 1.0, "deg": math.pi / 180.0},
}

#: Other spellings of units
SPELLINGS = {
    **dict.fromkeys(("second", "seconds", "sec"), "s"),
    **dict.fromkeys(("millisecond", "milliseconds", "msec"), "ms"),
    **dict.fromkeys(("microsecond", "microseconds", "µs"), "us"),
    **dict.fromkeys(("nanosecond", "nanoseconds", "nsec"), "ns"),
    **dict.fromkeys(("metre", "metres", "meter", "meters"), "m"),
    **dict.fromkeys(("centimetre", "centimetres", "centimeter", "centimeters"), "cm"),
    **dict.fromkeys(("millimetre", "millimetres", "millimeter", "millimeters"), "mm"),
    **dict.fromkeys(("newton", "newtons"), "N"),
    **dict.fromkeys(("lb", "lbs"), "lbf"),
    **dict.fromkeys(("Nm", "N.m", "N*m", "N·m", "N-m", "newton metre"), "N m"),
    **dict.fromkeys(("Nmm", "N.mm", "N*mm", "N·mm", "N-mm"), "N mm"),
    **dict.fromkeys(("Ncm", "N.cm", "N·cm", "N-cm"), "N cm"),
    **dict.fromkeys(("mNm", "mN.m", "mN·m", "mN-m"), "mN m"),
    **dict.fromkeys(("lbf-in", "lb-in", "in-lb", "lbf.in"), "lbf in"),
    **dict.fromkeys(("lbf-ft", "lb-ft", "ft-lb", "lbf.ft"), "lbf ft"),
    **dict.fromkeys(("", "-", "–", "dimensionless"), "1"),
    **dict.fromkeys(("radian", "radians"), "rad"),
    **dict.fromkeys(("degree", "degrees", "°"), "deg"),
}

#: Quantity of a column, by its name without the axis
QUANTITIES = {
    "p": "position",
    "q": "quaternion",
    "rv": "rotation vector",
    "f": "force",
}


def factor(quantity: str, word: str) -> float | None:
    """Factor from a unit to SI; None where it is no unit of the quantity.

    Args:
        quantity: A key of `UNITS`.
        word: The unit in any spelling.

    >>> factor("position", "millimeters"), factor("force", "mm")
    (0.001, None)
    """
    plain = word.strip()
    known = UNITS[quantity]
    found = known.get(SPELLINGS.get(plain, plain))
    if found is None:  # no two units of a quantity differ by case alone
        lower = {**known, **{s: known[u] for s, u in SPELLINGS.items() if u in known}}
        cases = {name.lower(): value for name, value in lower.items()}
        found = cases.get(plain.lower())
    return found


def quantity_of(column: str) -> str | None:
    """The quantity of a column by the package's name; None where it has no unit.

    >>> [quantity_of(name) for name in ("t", "px", "tx", "rvz", "segment")]
    ['time', 'position', 'torque', 'rotation vector', None]
    """
    if column == "t":
        return "time"
    if len(column) == 2 and column[0] == "t":
        return "torque"
    return QUANTITIES.get(column[:-1])


def any_unit(word: str) -> bool:
    """Whether a word is a unit of any quantity."""
    return any(factor(quantity, word) is not None for quantity in UNITS)

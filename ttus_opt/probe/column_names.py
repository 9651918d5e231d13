"""Names that other programs give to columns, and the units that they write there."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

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


POSITION, TORQUE = ("px", "py", "pz"), ("tx", "ty", "tz")
ROTATION_VECTOR = ("rvx", "rvy", "rvz")

#: Endings of ROS names, and the columns they stand for
ROS = {
    **{f"position.{c}": f"p{c}" for c in "xyz"},
    **{f"orientation.{c}": f"q{c}" for c in "wxyz"},
    **{f"translation.{c}": f"p{c}" for c in "xyz"},
    **{f"rotation.{c}": f"q{c}" for c in "wxyz"},
    **{f"force.{c}": f"f{c}" for c in "xyz"},
    **{f"torque.{c}": f"t{c}" for c in "xyz"},
    "time": "t",
    "__time": "t",  # PlotJuggler's
    "timestamp": "t",
    "stamp": "t",
}

#: Endings of two columns that make one time
WHOLE = re.compile(r"(?:.*[._])?(?:secs?|seconds)")
FRACTION = re.compile(r"(?:.*[._])?(?:nanosecs?|nsecs?|nanoseconds)")

#: Universal Robots' RTDE: position and rotation vector, force and torque
RTDE = {
    f"actual_tcp_{kind}_{i}": name
    for kind, names in (
        ("pose", ("px", "py", "pz", "rvx", "rvy", "rvz")),
        ("force", ("fx", "fy", "fz", "tx", "ty", "tz")),
    )
    for i, name in enumerate(names)
}

#: EuRoC's p_RS_R_x and q_RS_w
EUROC = re.compile(r"(p)_\w+_([xyz])|(q)_\w+_([wxyz])")

#: The package's own names
OWN = re.compile(r"t|[pft][xyz]|q[wxyz]|rv[xyz]|segment")

#: A name with its unit
WITH_UNIT = re.compile(
    r"(?P<name>.*?\S)\s*(?:\[(?P<unit>[^\[\]]*)\]|\((?P<also>[^()]*)\))"
)


class NamedColumn(NamedTuple):
    """A column's name and unit.

    Attributes:
        name: Without its unit.
        unit: As written; None where there is none.
    """

    name: str
    unit: str | None


def split_unit(name: str) -> NamedColumn:
    """A column's name and the unit behind it in brackets.

    >>> split_unit("tip_x [mm]"), split_unit("Fx (N)").unit, split_unit("px").unit
    (NamedColumn(name='tip_x', unit='mm'), 'N', None)
    """
    found = WITH_UNIT.fullmatch(name.strip())
    if found is None:
        return NamedColumn(name.strip(), None)
    unit = found["unit"] if found["unit"] is not None else found["also"]
    return NamedColumn(found["name"], unit.strip())


def known_name(name: str) -> str:
    """The package's name for a column, or its own name where it is unknown.

    >>> known_name("/robot/pose/orientation/w"), known_name("FX"), known_name("gain")
    ('qw', 'fx', 'gain')
    >>> {known_name(name) for name in ("stamp", "__time", "field.header.stamp")}
    {'t'}
    >>> known_name("Mz [Nm]"), known_name("actual_TCP_pose_3"), known_name("q_RS_w []")
    ('tz', 'rvx', 'qw')
    """
    plain = name.strip().strip('"').strip()
    dotted = _dotted(plain)
    if dotted in ROS:
        return ROS[dotted]
    for end, ours in ROS.items():
        if dotted.endswith(f".{end}"):
            return ours
    if dotted in RTDE:
        return RTDE[dotted]
    if euroc := EUROC.fullmatch(split_unit(plain).name):
        return "".join(part for part in euroc.groups() if part).lower()
    if re.fullmatch(r"m[xyz]", dotted):
        return f"t{dotted[1]}"
    return dotted if OWN.fullmatch(dotted) else plain


@dataclass(frozen=True)
class Header:
    """The columns of a table.

    Attributes:
        names: The package's name of every column, or its own.
        scale: Factor from its unit to SI, by column.
        sums: Columns that are the sum of several, by name.
        stated: Units that the file or the user states, as written, by name.
        faults: What is wrong with a column's unit, by column.
        absent: Names that the user maps and the header does not have.
        notes: What was taken for granted.
        frame: Where poses are and axes of wrenches, as the program documents it.
    """

    names: list[str]
    scale: list[float]
    sums: dict[str, list[int]] = field(default_factory=dict)
    stated: Mapping[str, str] = field(default_factory=dict)
    faults: dict[int, str] = field(default_factory=dict)
    absent: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()
    frame: str = "no frame stated"

    def noted(self, *notes: str) -> Header:
        """The same with more notes."""
        return replace(self, notes=(*self.notes, *notes))


def named_columns(
    given: Sequence[str], columns: Mapping[str, str], required: Sequence[str]
) -> Header:
    """What the columns of a header are.

    Args:
        given: Its words.
        columns: The file's names by the package's, as the user maps them.
        required: Columns that the caller needs.
    """
    names = [known_name(word) for word in given]
    units = [split_unit(word).unit for word in given]
    sums: dict[str, list[int]] = {}
    absent: list[str] = []
    for index, name in enumerate(names):
        if name in columns:  # the user maps another column to this name
            names[index] = f"{given[index]} (unused)"
    for ours, theirs in columns.items():
        terms = _terms(theirs, given)
        absent += [word for word, index, _ in terms if index is None]
        places = [index for _, index, _ in terms if index is not None]
        for word, place, unit in terms:
            if place is not None:
                names[place] = ours if len(terms) == 1 else f"{given[place]} (part)"
                units[place] = units[place] if unit is None else unit
                if len(terms) > 1 and FRACTION.fullmatch(_dotted(word)):
                    units[place] = units[place] or "ns"
        if len(places) == len(terms) > 1:
            sums[ours] = places
    header = Header(names, [1.0] * len(names), sums, absent=tuple(absent))
    if any(word.lower() in RTDE for word in given):
        header = replace(header, frame="the robot's base (RTDE)")
    return _scaled(_adjusted(header, units, given, required), units)


def _terms(
    theirs: str, given: Sequence[str]
) -> list[tuple[str, int | None, str | None]]:
    """Word, column and unit of the columns that are added up."""
    bare = [split_unit(word).name for word in given]
    out: list[tuple[str, int | None, str | None]] = []
    for word in [theirs] if theirs in (*given, *bare) else theirs.split("+"):
        name, unit = word.strip(), None
        if name not in given and name not in bare:
            name, unit = split_unit(name)
        index = next(
            (names.index(name) for names in (list(given), bare) if name in names), None
        )
        out.append((name, index, unit))
    return out


def _dotted(word: str) -> str:
    return split_unit(word).name.lower().replace("/", ".").lstrip(".")


def _adjusted(
    header: Header,
    units: list[str | None],
    given: Sequence[str],
    required: Sequence[str],
) -> Header:
    """The header with what names alone leave open settled, units in place."""
    names, sums = header.names, header.sums
    times = [i for i, name in enumerate(names) if name == "t"]
    words = [_dotted(given[i]) for i in times]
    if len(set(words)) == len(words) > 1:  # of several clocks, the message's own
        best = min(times, key=lambda i: _rank(_dotted(given[i])))
        for i in times:
            names[i] = "t" if i == best else f"{given[i]} (unused)"
    if not times and "t" not in sums and "t" in required:
        dotted = [_dotted(word) for word in given]
        whole = [i for i, word in enumerate(dotted) if WHOLE.fullmatch(word)]
        fraction = [i for i, word in enumerate(dotted) if FRACTION.fullmatch(word)]
        if len(whole) == len(fraction) == 1:
            sums["t"] = [*whole, *fraction]
            units[whole[0]] = units[whole[0]] or "s"
            units[fraction[0]] = units[fraction[0]] or "ns"
    alike = all(name in names for name in (*TORQUE, "qw")) and "fx" not in names
    if alike and "px" in required and not any(name in names for name in POSITION):
        for theirs, ours in zip(TORQUE, POSITION, strict=True):
            names[names.index(theirs)] = ours
        return header.noted("tx,ty,tz beside a quaternion and no force are positions")
    return header


def _rank(word: str) -> int:
    """Lower for a better clock: the header's stamp before the time of arrival."""
    order = ("t", "stamp", "timestamp", "time", "__time")
    return next((i for i, end in enumerate(order) if word.split(".")[-1] == end), 9)


def _scaled(header: Header, units: Sequence[str | None]) -> Header:
    """The header with factors to SI."""
    scale, faults, stated = [*header.scale], {}, dict[str, str]()
    ours = dict(enumerate(header.names))
    ours |= {i: name for name, terms in header.sums.items() for i in terms}
    for index, name in ours.items():
        quantity, unit = quantity_of(name), units[index]
        if quantity is None or unit is None or not OWN.fullmatch(name):
            continue
        found = _factor(quantity, unit)
        if found is None:
            faults[index] = (
                f"{name} has the unit {unit!r}, expected one of "
                f"{', '.join(UNITS[quantity])}: state it by columns, {name}=NAME[UNIT]"
            )
        else:
            scale[index] = found
            stated[name] = f"{stated[name]} + {unit}" if name in stated else unit
    return replace(header, scale=scale, stated=stated, faults=faults)


def _factor(quantity: str, unit: str) -> float | None:
    """Factor to SI of a unit, a number or a quotient of two ("1/60")."""
    over, _, under = unit.partition("/")
    try:
        return float(over) / float(under or 1.0)
    except (ValueError, ZeroDivisionError):
        return factor(quantity, unit)

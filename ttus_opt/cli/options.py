"""Options several commands share, and reading what they name."""

from __future__ import annotations

import json
import os
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt import io
from ttus_opt.cli.console import as_options
from ttus_opt.errors import FileError, InputError, TtusError, TtusWarning

if TYPE_CHECKING:
    from ttus_opt.probe.conventions import Conventions
    from ttus_opt.probe.point_shell import PointShell
    from ttus_opt.probe.trajectory import Trajectory

Json = Annotated[bool, typer.Option("--json", help="JSON on stdout, for machines.")]
Field = Annotated[Path, typer.Option("--field", help="Field file (.nc).")]
Probe = Annotated[
    str,
    typer.Option(
        "--probe",
        help="ellipsoid:a,b,c (semi-axes), sphere:r, box:a,b,c (edges) in metres, "
        "or a mesh file (STL, PLY, OBJ).",
    ),
]
ProbeUnit = Annotated[
    str, typer.Option("--probe-unit", help="Unit of a mesh file: m, cm, mm, in.")
]
ProbeSurface = Annotated[
    str,
    typer.Option("--probe-surface", help="What to keep of a mesh: outer, all, hull."),
]
Points = Annotated[int, typer.Option("--points", help="Points of the probe's shell.")]
Force = Annotated[
    bool, typer.Option("--force", help="Let an output replace one of the inputs.")
]
Columns = Annotated[
    str,
    typer.Option(
        metavar="NAME=COLUMN,…",
        help="Names of the file's columns by ours, for instance px=tip_x; ROS's names "
        "are known.",
    ),
]
QuaternionOrder = Annotated[
    str,
    typer.Option(
        "--quaternion",
        help="Order of qw,qx,qy,qz as they stand: wxyz, or xyzw under those names.",
    ),
]
WrenchFrame = Annotated[
    str, typer.Option(help="Axes of measured wrenches: patient or tool.")
]
FlipWrench = Annotated[
    bool,
    typer.Option("--flip-wrench", help="Wrenches are those of the probe on the skin."),
]
TorqueUnit = Annotated[str, typer.Option(help="Unit of measured torques: Nm or Nmm.")]
TorqueAbout = Annotated[
    str,
    typer.Option(
        help="What torques are about: centroid (of the probe's area), origin (of the "
        "pose, as CAD and ROS have it) or x,y,z in the probe's frame [m]."
    ),
]
WrenchDelay = Annotated[
    float, typer.Option(help="By how much wrenches lag behind poses [s].")
]
Trajectories = Annotated[
    list[Path],
    typer.Option(
        "--trajectory", metavar="PATH", help="Trajectory CSV; may be repeated."
    ),
]


def numbers(text: str, count: int, option: str) -> tuple[float, ...]:
    """Numbers separated by commas.

    Args:
        text: As typed.
        count: How many there must be.
        option: For the message.

    Returns:
        The numbers.

    Raises:
        InputError: Another count, or no numbers.

    >>> numbers("0,0.5,1", 3, "--axis-origin")
    (0.0, 0.5, 1.0)
    """
    try:
        values = tuple(float(v) for v in text.split(","))
    except ValueError:
        values = ()
    if len(values) != count:
        raise InputError(
            f"{option} takes {count} numbers separated by commas, got {text!r}"
        )
    return values


def whole_numbers(text: str, count: int, option: str) -> tuple[int, ...]:
    """Whole numbers separated by commas; see `numbers`.

    Raises:
        InputError: Another count, or numbers with a fraction.
    """
    values = numbers(text, count, option)
    if any(not v.is_integer() for v in values):
        raise InputError(f"{option} takes whole numbers, got {text!r}")
    return tuple(int(v) for v in values)


def check_outputs(
    outputs: Sequence[Path | None],
    inputs: Sequence[Path | str],
    *,
    force: bool,
    size: int = 0,
) -> None:
    """Check every output before work begins.

    Args:
        outputs: Files that will be written; None where an option was not given.
        inputs: Files that are read; a probe may also be a primitive's description.
        force: Allow an output to replace an input.
        size: Bytes the largest takes, about.

    Raises:
        FileError: One cannot be written, replaces an input, or two are the same.
    """
    given = [output for output in outputs if output is not None]
    for output in given:
        try:
            io.check_output(output, inputs=inputs, force=force, size=size)
        except FileError as error:
            raise FileError(str(error).replace("pass force", "add --force")) from error
    if len({os.path.realpath(output) for output in given}) < len(given):
        raise FileError(f"{given[0]} is named for two outputs: name another")


def read_probe(spec: str, n_points: int, unit: str, surface: str) -> PointShell:
    """The point shell of ``--probe``.

    Raises:
        InputError: Whatever is wrong with it, in the words of the command line.
    """
    from ttus_opt.probe.point_shell import PointShell

    try:
        return PointShell.from_spec(
            spec,
            n_points=n_points,
            unit=unit,
            surface=surface,  # type: ignore[arg-type]  # checked there
        )
    except TtusError as error:
        raise InputError(as_options(str(error), unit="--probe-unit")) from error


def read_conventions(torque_about: str, **told: Any) -> Conventions:
    """How recordings are written, as the options say.

    Args:
        torque_about: As typed.
        told: The other fields of `Conventions`.

    Raises:
        InputError: In the words of the command line.
    """
    from ttus_opt.probe.conventions import Conventions

    about: Any = torque_about
    if "," in torque_about:
        about = numbers(torque_about, 3, "--torque-about")
    try:
        return Conventions(torque_about=about, **told)
    except InputError as error:
        name, _, rest = str(error).partition(" ")
        raise InputError(f"--{name.replace('_', '-')} {rest}") from error


def warn_of_another_probe(
    provenance: Mapping[str, str], probe: str, conventions: Conventions
) -> None:
    """Say when a field was fitted with another probe or other torques.

    Args:
        provenance: Of the field.
        probe: As typed.
        conventions: Of the recordings at hand.

    Raises:
        FileError: The provenance is damaged.
    """
    fitted = provenance.get("probe")
    own = probe_name(probe)
    if fitted and fitted != own:
        warnings.warn(
            f"the field was fitted with probe {fitted}, this is {own}: forces of "
            "another probe are a prediction, not a check",
            TtusWarning,
            stacklevel=2,
        )
    try:
        written = json.loads(provenance.get("conventions", "{}")).get("torque_about")
    except (ValueError, AttributeError, TypeError) as error:
        raise FileError(
            "the field file's conventions are damaged: fit the field again"
        ) from error
    about = tuple(written) if isinstance(written, list) else written
    if about and about != conventions.torque_about:
        warnings.warn(
            f"the field was fitted to torques about {about}, these are about "
            f"{conventions.torque_about}: is --torque-about right?",
            TtusWarning,
            stacklevel=2,
        )


def probe_name(probe: str) -> str:
    """A probe as a field file names it: its description, or its file's name."""
    return probe if ":" in probe else Path(probe).name


def read_trajectories(paths: Sequence[Path], columns: str = "") -> Trajectory:
    """All recordings as one trajectory, with the files' numbers taken at their word.

    Args:
        paths: The files.
        columns: Pairs ``ours=theirs`` of column names, separated by commas.

    Raises:
        FileError: A file is not a usable trajectory.
        InputError: Only some of them have wrenches, or columns that are no pairs.
    """
    from ttus_opt.probe.trajectory import Trajectory, read_trajectory

    pairs = [pair.partition("=") for pair in columns.split(",") if pair]
    if not all(ours and theirs for ours, _, theirs in pairs):
        raise InputError(f"--columns takes NAME=COLUMN,…, got {columns!r}")
    told = {ours.strip(): theirs.strip() for ours, _, theirs in pairs}
    return Trajectory.concatenate(
        [read_trajectory(path, columns=told) for path in paths]
    )

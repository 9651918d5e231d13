"""``ttus-opt encode`` and ``ttus-opt decode``: messages for a thin link."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.console import Stages, tell
from ttus_opt.core import io

if TYPE_CHECKING:
    from ttus_opt.scan.surface import Surface
    from ttus_opt.voxmap.field import PotentialField


def encode(
    file: Annotated[Path, typer.Argument()],
    output: Path,
    base: list[Path] | None = None,
    max_error: float | None = None,
) -> None:
    """Write a surface or a field as a short message.

    A field is sent as what it adds to the Laplace field of its surface: give the
    surface's message as --base. A surface with --base is sent as what changed. Needs
    the extra `sensors`.

    Args:
        file: Surface or field file (.nc).
        output: Message file.
        base: Message it builds on; may be repeated: a surface and its changes in their
            order.
        max_error: Largest error of a radius [m], by default 0.00025, or of the
            potential [its unit], by default 0.005, or 0.01 for a field whose surface
            was rounded after the fit.

    Example:
        ttus-opt encode field.nc --base surface.msg -o field.msg
    """
    from ttus_opt.message.codec import decode as decoded
    from ttus_opt.message.codec import encode as encoded
    from ttus_opt.message.envelope import read_message

    bases = base or []
    with Stages(3) as begin:
        begin("reading")
        what = _read(file)
        before = [read_message(path)[0] for path in bases] or None
        begin("encoding")
        message = encoded(what, max_error=max_error, base=before)
        begin("checking what will be decoded")
        most = max(_size(what), 1)
        error = _error(what, decoded(message, base=before, max_voxels=most))
        io.write_bytes(output, message)
    facts = {
        "output": str(output),
        "holds": _name(what),
        "bytes": len(message),
        "largest_error": error,
    }
    told = f"{error:.3g} of the potential" if _size(what) else f"{1e3 * error:.3g} mm"
    size = f"{len(message):,} bytes, largest error"
    tell(facts, f"{output}: {_name(what)} in {size} {told}")


def decode(
    file: Annotated[Path, typer.Argument()],
    output: Path,
    base: list[Path] | None = None,
    max_voxels: int = 400_000,
) -> None:
    """Read a message and write its surface or field file.

    Damaged and hostile messages are refused before anything is allocated. Needs the
    extra `sensors`.

    Args:
        file: Message file.
        output: Surface or field file (.nc).
        base: Message it builds on; may be repeated: a surface and its changes in their
            order.
        max_voxels: Fields of more voxels are refused.

    Example:
        ttus-opt decode field.msg --base surface.msg -o field.nc
    """
    from ttus_opt.message.codec import decode as decoded
    from ttus_opt.message.envelope import read_message

    bases = base or []
    with Stages(2) as begin:
        begin("decoding")
        message, _ = read_message(file)
        before = [read_message(path)[0] for path in bases] or None
        what = decoded(message, base=before, max_voxels=max_voxels)
        begin("writing")
        what.save(output)
    facts = {"output": str(output), "holds": _name(what), "bytes": len(message)}
    tell(facts, f"{output}: {_name(what)} from {len(message):,} bytes")


def _read(file: Path) -> Surface | PotentialField:
    """A surface or a field file, whichever it is."""
    from ttus_opt.scan.surface import Surface
    from ttus_opt.voxmap.field import PotentialField

    if io.kind_of(file, "surface or field") == "field":
        return PotentialField.load(file)
    return Surface.load(file)


def _size(what: Any) -> int:
    """Voxels of a field, 0 of a surface."""
    return 0 if _name(what) == "surface" else int(what.values.size)


def _name(what: Surface | PotentialField) -> str:
    return "surface" if hasattr(what, "radius") else "field"


def _error(sent: Any, received: Any) -> float:
    """Largest difference of radii [m], or of potentials where contact reads them."""
    import numpy as np

    if not _size(sent):
        return float(np.abs(sent.radius - received.radius).max())
    from ttus_opt.message.field_message import sampled

    read = sampled(received.voxmap)
    return float(np.abs(sent.values - received.values)[read].max())

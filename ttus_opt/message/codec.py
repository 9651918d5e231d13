"""`encode` and `decode`: one pair of calls for every kind of message."""

from __future__ import annotations

from collections.abc import Sequence

from ttus_opt.core.errors import InputError
from ttus_opt.message import field_message, surface_message
from ttus_opt.message.envelope import FIELD, NAMES, SURFACE, SURFACE_DELTA, Reader
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.field import PotentialField

#: A message, or a surface's message and its changes in order
Base = bytes | Sequence[bytes]


def encode(
    what: Surface | PotentialField,
    *,
    max_error: float | None = None,
    base: Base | None = None,
) -> bytes:
    """A surface or a field as a short, checksummed message.

    Args:
        what: The surface, or the field.
        max_error: Largest error after decoding: of a radius (0.25 mm by default) [m],
            of a potential where contact reads it (0.005 by default, 0.01 if its
            surface was rounded after the fit) [its unit].
        base: What the receiver has: for a field the message of its surface; for a
            surface an earlier message, so that only changes are sent. With changes
            since, all messages in order.

    Raises:
        InputError: A field without its surface's message, an invalid bound, or a base
            of another grid or frame.
        MissingPackageError: pcodec is not installed.
    """
    if isinstance(what, Surface):
        bound = surface_message.MAX_ERROR if max_error is None else max_error
        if base is None:
            return surface_message.encode_surface(what, bound)
        return surface_message.encode_surface_delta(what, *_surface(base), bound)
    if base is None:
        raise InputError(
            "a field is encoded as its difference from the Laplace field of its "
            "surface: give the surface's message as base=…"
        )
    return field_message.encode_field(what, *_surface(base), max_error)


def decode(
    message: bytes,
    *,
    base: Base | None = None,
    max_voxels: int = field_message.MOST_VOXELS,
) -> Surface | PotentialField:
    """The content of a message; untrusted ones are safe.

    Sizes are checked before anything is allocated.

    Args:
        message: The bytes.
        base: The message it builds on; with changes since, all in order.
        max_voxels: Largest field that is accepted; one of 400,000 voxels, the default,
            takes up to 64 MiB and one solve of Laplace's equation in 12 V-cycles.

    Raises:
        InputError: It is damaged, hostile, of another version, or builds on another
            message than the base given.
        NumericalError: Laplace's equation cannot be solved on the message's grid.
        MissingPackageError: pcodec is not installed.
    """
    reader = Reader(message)
    if reader.kind == SURFACE:
        if base is not None:
            raise InputError("a whole surface needs no base: leave it out")
        return surface_message.decode_surface(reader)
    if base is None:
        raise InputError(
            f"the message holds a {NAMES[reader.kind]}, which builds on another "
            "message: give that as base=…"
        )
    surface, name = _surface(base)
    if reader.kind == FIELD:
        return field_message.decode_field(reader, surface, name, max_voxels)
    return surface_message.decode_surface_delta(reader, surface, name)


def _surface(base: Base) -> tuple[Surface, int]:
    """The surface after all messages, and the last one's name.

    Raises:
        InputError: The first is not a surface, or one does not follow from the last.
    """
    messages = [base] if isinstance(base, bytes | bytearray) else list(base)
    if not messages:
        raise InputError("base is empty: give the surface's message")
    first, *changes = [Reader(message) for message in messages]
    if first.kind != SURFACE:
        raise InputError(
            f"the first base is a {NAMES[first.kind]}: give the surface's message first"
        )
    surface, name = surface_message.decode_surface(first), first.name
    for change in changes:
        if change.kind != SURFACE_DELTA:
            raise InputError(
                f"a base after the first is a {NAMES[change.kind]}: give changes of "
                "the surface, in their order"
            )
        surface = surface_message.decode_surface_delta(change, surface, name)
        name = change.name
    return surface, name

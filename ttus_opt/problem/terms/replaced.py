"""Copies of frozen objects that share cached properties."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

_Member = TypeVar("_Member")


def replaced(member: _Member, *cached: str, **changes: Any) -> _Member:
    """`dataclasses.replace` that keeps cached properties.

    Args:
        member: A frozen dataclass.
        cached: Names of cached properties that the changes do not affect; others are
            recomputed.
        changes: New values of fields.
    """
    other: _Member = replace(member, **changes)  # type: ignore[type-var]
    known = vars(member)
    vars(other).update({name: known[name] for name in cached if name in known})
    return other

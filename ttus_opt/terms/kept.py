"""Copies of frozen objects that keep what was computed once."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

_Member = TypeVar("_Member")


def replaced(member: _Member, *cached: str, **changes: Any) -> _Member:
    """`dataclasses.replace` that hands cached properties on.

    Args:
        member: A frozen dataclass.
        cached: Names of its cached properties that the changes leave as they are.
        changes: Fields with their new values.

    Returns:
        The copy; its other cached properties are computed anew.
    """
    other: _Member = replace(member, **changes)  # type: ignore[type-var]
    own = vars(member)
    vars(other).update({name: own[name] for name in cached if name in own})
    return other

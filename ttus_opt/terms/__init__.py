"""Terms of an objective: one file per member.

`ttus_opt.terms.LaplaceTerm` and the like find their file; ``dir(ttus_opt.terms)`` lists
what there is.
"""

from __future__ import annotations

import sys

from ttus_opt import shelf


def __getattr__(name: str) -> type:
    """Find a class in the files of this folder."""
    return shelf.member(sys.modules[__name__], name)


def __dir__() -> list[str]:
    """The classes there are."""
    return sorted(shelf.members(sys.modules[__name__]))

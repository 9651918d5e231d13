"""Constraints of a problem: one file per member.

`ttus_opt.problem.constraints.Sign` and the like find their file;
``dir(ttus_opt.problem.constraints)`` lists what there is.
"""

from __future__ import annotations

import sys

from ttus_opt.core import plugins


def __getattr__(name: str) -> type:
    """Find a class in the files of this folder."""
    return plugins.class_of(sys.modules[__name__], name)


def __dir__() -> list[str]:
    """The classes there are."""
    return sorted(plugins.classes_of(sys.modules[__name__]))

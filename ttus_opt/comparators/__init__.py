"""Other ways from measurements to forces, on the same data and by the same interface.

    from ttus_opt import comparators
    rival = comparators.create("kelvin_voigt", surface=surface, shell=shell)
    wrench = rival.fit([press, sweep]).render(rotation, position, twist)

`available` lists them, `compare` sets several against each other on recordings that
none has seen. Each stands in a file of its own with its source; a file added to this
folder with a class over `Comparator` is one more. See docs/comparators.md.
"""

from __future__ import annotations

from ttus_opt.comparators.base import Comparator, RendersWrenches
from ttus_opt.comparators.comparison import Row, compare, markdown
from ttus_opt.comparators.registry import available, create, kind

__all__ = [
    "Comparator",
    "RendersWrenches",
    "Row",
    "available",
    "compare",
    "create",
    "kind",
    "markdown",
]

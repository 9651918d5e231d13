"""Other contact models from the literature, on the same data and with one interface.

    from ttus_opt import comparators
    rival = comparators.create("kelvin_voigt", surface=surface, shell=shell)
    wrench = rival.fit([press, sweep]).render(rotation, position, twist)

`available` lists them, `compare` compares several on unseen recordings. Each is in its
own file with its source; a new one is a file in this folder with a subclass of
`Comparator`. See docs/comparators.md.
"""

from __future__ import annotations

from ttus_opt.comparators.base import Comparator
from ttus_opt.comparators.comparison import (
    Row,
    available,
    compare,
    create,
    kind,
    markdown,
)

__all__ = [
    "Comparator",
    "Row",
    "available",
    "compare",
    "create",
    "kind",
    "markdown",
]

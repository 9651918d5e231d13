"""What terms and constraints have in common: a scene, and a name of their class."""

from __future__ import annotations

import abc
from dataclasses import dataclass, field

from ttus_opt.errors import InputError
from ttus_opt.scene import Scene


@dataclass(frozen=True)
class Member(abc.ABC):
    """A member of a formulation.

    Attributes:
        scene: What its rows are made from.
    """

    scene: Scene = field(repr=False)

    @property
    def name(self) -> str:
        """Name under which it is addressed, and its cost, slack or dual returned.

        Raises:
            InputError: The class has no name.
        """
        kind = type(self).__name__
        raise InputError(f'{kind} has no name: add name = "…" to the class')

    @abc.abstractmethod
    def rows(self) -> object:
        """What it states of the variables."""

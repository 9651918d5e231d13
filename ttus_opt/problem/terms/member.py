"""The common base of terms and constraints: a scene, and a name of their class."""

from __future__ import annotations

import abc
from dataclasses import dataclass, field

from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import InputError


@dataclass(frozen=True)
class Member(abc.ABC):
    """A member of a formulation.

    Attributes:
        scene: The scene from which its rows are made.
    """

    scene: Scene = field(repr=False)

    @property
    def name(self) -> str:
        """Its name, and that of its cost, slack or dual.

        Raises:
            InputError: The class has no name.
        """
        kind = type(self).__name__
        raise InputError(f'{kind} has no name: add name = "…" to the class')

    @abc.abstractmethod
    def rows(self) -> object:
        """Its rows over the variables."""

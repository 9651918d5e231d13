"""What terms and constraints are: members with a scene, a name and rows."""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import scipy.sparse as sp

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.structure import Tags

_Member = TypeVar("_Member")


@dataclass(frozen=True)
class AffineRows:
    """Named rows r = Σ_k M_k x_k - t over the variables x_k they touch.

    Attributes:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        target: t, shape (m,).
        tags: Structure that solvers may use, see `ttus_opt.problem.terms.structure`.
    """

    blocks: Mapping[str, sp.csr_array]
    target: Array
    tags: Tags = frozenset()


@dataclass(frozen=True)
class LinearRows:
    """Rows lower ≤ Σ_k M_k x_k ≤ upper.

    Attributes:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        lower: Lower limits, -inf where there is none, shape (m,).
        upper: Upper limits, +inf where there is none, shape (m,).
        tags: Structure that solvers may use, see `ttus_opt.problem.terms.structure`.
    """

    blocks: Mapping[str, sp.csr_array]
    lower: Array
    upper: Array
    tags: Tags = frozenset()


@dataclass(frozen=True)
class ConeRows:
    """Rows s = Σ_k M_k x_k + h in second-order cones, s₀ ≥ ‖(s₁, …)‖ each.

    Attributes:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        offset: h, shape (m,).
        sizes: Rows of each cone, one cone after the other, m in all.
    """

    blocks: Mapping[str, sp.csr_array]
    offset: Array
    sizes: tuple[int, ...]


@dataclass(frozen=True)
class Bounds:
    """Bounds lower ≤ x_k ≤ upper on one whole variable.

    Attributes:
        variable: Its name.
        lower: Shape of the variable, -inf where there is none.
        upper: Shape of the variable, +inf where there is none.
    """

    variable: str
    lower: Array
    upper: Array


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

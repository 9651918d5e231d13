"""Base class of terms: a penalty φ of an affine residual, weight · φ(M x - t).

The weight is kept apart from the rows, so that it can be changed without assembling
them again.
"""

from __future__ import annotations

import abc
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Self

from ttus_opt.core.arguments import expect_not_negative
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.core.plugins import defined_at, user_errors
from ttus_opt.problem.terms.penalties import Penalty, Squares
from ttus_opt.problem.terms.rows import AffineRows as AffineRows
from ttus_opt.problem.terms.rows import (
    ConeRows,
    LinearRows,
    Member,
    replaced,
    uniform_blocks,
    uniform_vector,
)
from ttus_opt.problem.terms.structure import check_structure


@dataclass(frozen=True, eq=False)
class Fitted:
    """A parameter that a convex fit finds among its variables.

    Attributes:
        gradient: Its derivative with respect to each variable it depends on, by name,
            shape of the variable; empty if undefined.
        span: Plausible distance from its neutral value 0 [its unit].
        upper: Its upper limit [its unit]; inf for none.
    """

    gradient: Mapping[str, Array] = field(repr=False)
    span: float
    upper: float = math.inf


@dataclass(frozen=True)
class Term(Member):
    """A weighted penalty of an affine residual over a scene.

    Attributes:
        weight: Its λ, non-negative [–].
    """

    weight: float = 1.0

    #: Whether its rows are measurements, so that residuals are noise
    measures: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Refuse a weight that is negative or not finite."""
        expect_not_negative(self.weight, f"{self.name} weight")

    @property
    def formula(self) -> str:
        """The mathematics, for `repr` of a formulation."""
        return f"{self.penalty.formula}, r = M x − t"

    @property
    def penalty(self) -> Penalty:
        """The penalty φ."""
        return Squares()

    @abc.abstractmethod
    def rows(self) -> AffineRows:
        """The residual's rows and target."""

    @cached_property
    def assembled(self) -> AffineRows:
        """`rows`, computed once, as arrays of floats, and shared by reweighted copies.

        Raises:
            InputError: `rows` raises, a row or a target is not finite, sizes do not
                match, or a tag is wrong.
        """
        owner = f"term {self.name}{defined_at(type(self).rows)}"
        with user_errors(f"rows() of term {self.name}"):
            rows = self.rows()
        if not isinstance(rows, AffineRows):
            raise InputError(
                f"{owner}: rows() must return AffineRows, got {type(rows).__name__}"
            )
        target = uniform_vector(owner, "target", rows.target, finite=True)
        blocks = uniform_blocks(owner, rows.blocks, len(target))
        group = self.penalty.rows_per_group
        if len(target) % group:
            raise InputError(
                f"{owner}: its penalty takes groups of {group} rows, got {len(target)}"
            )
        check_structure(owner, rows.tags, blocks, self.scene.laplace)
        return AffineRows(blocks, target, rows.tags)

    @property
    def requires(self) -> Mapping[str, LinearRows | ConeRows]:
        """Rows that define its auxiliary variables, by name; empty for most terms."""
        return {}

    @property
    def takes(self) -> tuple[str, ...]:
        """Variables that another member must have too; none for most terms."""
        return ()

    def with_weight(self, weight: float) -> Self:
        """The same term with another weight, without assembling it again.

        Raises:
            InputError: The weight is negative or not finite.
        """
        return replaced(self, "assembled", weight=weight)

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """Parameters that a solution identifies, such as friction, by name.

        Args:
            values: The solution's variables by name.
        """
        return {}

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """Those of its `parameters` that are variables of the program, by name.

        Args:
            values: The solution's variables by name.
        """
        return {}

    def not_identifiable(self) -> dict[str, str]:
        """Why parameters are not determined by its rows, by name."""
        return {}

    def with_neutral(self, names: Collection[str]) -> Self:
        """The same term with some of its parameters at their neutral values."""
        return self

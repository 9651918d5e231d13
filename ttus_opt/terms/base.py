"""What a term is: a penalty φ of an affine residual, weight · φ(M x - t).

A term says its rows and its target; who minimises it is not its business. The
weight is a number beside the rows, never multiplied into them, so that it can be
changed without assembling anything again.
"""

from __future__ import annotations

import abc
import copy
import enum
import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar, Self

import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.scene import Scene
from ttus_opt.terms.declared_rows import check_declared


class Penalty(enum.Enum):
    """How a residual r is charged."""

    SQUARES = "Σ r²"
    HUBER = "Σ huber(r; δ), r² up to δ and 2δ|r| − δ² beyond"
    ABSOLUTE = "Σ |r|"
    GROUPS = "Σ ‖r_g‖ over groups of consecutive rows"
    LINEAR = "Σ r"


@dataclass(frozen=True)
class AffineRows:
    """Named rows r = Σ_k M_k x_k - t over the variables x_k they touch.

    Attributes:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        target: t, shape (m,).
    """

    blocks: Mapping[str, sp.csr_array]
    target: Array


@dataclass(frozen=True)
class Fitted:
    """A parameter that a convex fit finds among its variables.

    Attributes:
        gradient: Its derivative by each variable it depends on, by name, shape of the
            variable; empty where the field leaves it undefined.
        span: How far from its neutral value 0 it may plausibly lie [its unit].
        upper: Its largest value; inf where there is none [its unit].
    """

    gradient: Mapping[str, Array] = field(repr=False)
    span: float
    upper: float = math.inf


@dataclass(frozen=True)
class Term(abc.ABC):
    """A weighted penalty of an affine residual over a scene.

    Attributes:
        scene: What the rows are made from.
        weight: Its λ, not negative [–].
    """

    scene: Scene = field(repr=False)
    weight: float = 1.0

    #: Name under which cost and weight are addressed
    name: ClassVar[str]
    #: The mathematics, for `repr` of a formulation
    formula: ClassVar[str]
    #: Whether its rows are measurements, whose noise the residuals show
    measures: ClassVar[bool] = False

    def __post_init__(self) -> None:
        """Refuse a weight that is no weight.

        Raises:
            InputError: The weight is negative or not finite.
        """
        if not (math.isfinite(self.weight) and self.weight >= 0.0):
            raise InputError(
                f"{self.name} weight must be finite and not negative, got "
                f"{self.weight:g}"
            )

    @property
    def penalty(self) -> Penalty:
        """How the residual is charged."""
        return Penalty.SQUARES

    @property
    def threshold(self) -> float:
        """Huber's δ; unused by other penalties."""
        return math.inf

    @property
    def group_size(self) -> int:
        """Rows per group of `Penalty.GROUPS`; unused by other penalties."""
        return 1

    @property
    def laplace_scale(self) -> Array | None:
        """For solvers that use L's structure: what the rows of L are multiplied by.

        Shape (V,), where the rows are the free rows of the scene's L in order, each
        times its own positive number; None for anything else.
        """
        return None

    @abc.abstractmethod
    def rows(self) -> AffineRows:
        """The residual's rows and target."""

    @cached_property
    def assembled(self) -> AffineRows:
        """`rows`, made once and kept by every copy with another weight.

        Raises:
            InputError: A row or a target is not finite, or they do not fit together.
        """
        rows = self.rows()
        check_declared(f"term {self.name}", rows.blocks, {"target": rows.target})
        return rows

    def with_weight(self, weight: float) -> Self:
        """The same term with another weight; nothing is assembled again.

        Raises:
            InputError: The weight is negative or not finite.
        """
        other = copy.copy(self)  # the assembled rows come along
        object.__setattr__(other, "weight", weight)
        other.__post_init__()
        return other

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """What the solution identifies beside the field, by name.

        Args:
            values: The solution's variables by name.

        Returns:
            For instance a friction coefficient; empty for most terms.
        """
        return {}

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """Those of its `parameters` that are found among the variables, by name.

        Args:
            values: The solution's variables by name.
        """
        return {}

    def unborne(self) -> dict[str, str]:
        """Parameters of which its rows say nothing, and why, by name."""
        return {}

    def without(self, names: Collection[str]) -> Self:
        """The same term with these of its parameters at their neutral value."""
        return self

"""What a constraint is: lower ≤ M x ≤ upper, or bounds on a variable itself.

The same knowledge may be a term (soft) or a constraint (hard); the caller decides.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import ClassVar

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError
from ttus_opt.scene import Scene
from ttus_opt.terms.declared_rows import check_declared


@dataclass(frozen=True)
class LinearRows:
    """Rows lower ≤ Σ_k M_k x_k ≤ upper.

    Attributes:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        lower: Lower limits, -inf where there is none, shape (m,).
        upper: Upper limits, +inf where there is none, shape (m,).
    """

    blocks: Mapping[str, sp.csr_array]
    lower: Array
    upper: Array


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
class Constraint(abc.ABC):
    """Something known for certain about the solution.

    Attributes:
        scene: What the rows are made from.
    """

    scene: Scene = field(repr=False)

    #: Name under which slack and dual are returned
    name: ClassVar[str]
    #: The mathematics, for `repr` of a formulation
    formula: ClassVar[str]

    @abc.abstractmethod
    def rows(self) -> LinearRows | Bounds:
        """The constraint's rows, or bounds on a variable."""

    @cached_property
    def assembled(self) -> LinearRows | Bounds:
        """`rows`, made once.

        Raises:
            InputError: A row or limit is NaN, a limit can hold for no number at all,
                or they do not fit together.
        """
        rows, owner = self.rows(), f"constraint {self.name}"
        blocks = rows.blocks if isinstance(rows, LinearRows) else {}
        check_declared(
            owner, blocks, {"lower limit": rows.lower, "upper limit": rows.upper}
        )
        for name, none in (
            ("lower", rows.lower == np.inf),
            ("upper", rows.upper == -np.inf),
        ):
            if none.any():
                raise InputError(
                    f"{owner}: {int(none.sum())} {name} limits are infinite on the "
                    "wrong side, nothing obeys them: use -inf below and inf above "
                    "where there is no limit"
                )
        return rows

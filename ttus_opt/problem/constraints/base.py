"""Base class of constraints: lower ≤ M x ≤ upper, cones, or bounds on a variable."""

from __future__ import annotations

import abc
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.core.plugins import defined_at, user_errors
from ttus_opt.problem.terms.rows import Bounds as Bounds
from ttus_opt.problem.terms.rows import ConeRows as ConeRows
from ttus_opt.problem.terms.rows import LinearRows as LinearRows
from ttus_opt.problem.terms.rows import Member, uniform_blocks, uniform_vector
from ttus_opt.problem.terms.structure import check_structure


@dataclass(frozen=True)
class Constraint(Member):
    """A condition that the solution must satisfy."""

    @property
    def formula(self) -> str:
        """The mathematics, for `repr` of a formulation."""
        return "lower ≤ M x ≤ upper"

    @abc.abstractmethod
    def rows(self) -> LinearRows | ConeRows | Bounds:
        """The constraint's rows, or bounds on a variable."""

    @cached_property
    def assembled(self) -> LinearRows | ConeRows | Bounds:
        """`rows`, computed once and in one format.

        Raises:
            InputError: `rows` raises, a row or limit is not a number, a limit is
                infinite on the wrong side, sizes do not match, or a tag is wrong.
        """
        owner = f"constraint {self.name}{defined_at(type(self).rows)}"
        with user_errors(f"rows() of constraint {self.name}"):
            rows = self.rows()
        if isinstance(rows, ConeRows):
            return _uniform_cones(owner, rows)
        if not isinstance(rows, LinearRows | Bounds):
            raise InputError(
                f"{owner}: rows() must return LinearRows, ConeRows or Bounds, got "
                f"{type(rows).__name__}"
            )
        lower, upper = (
            uniform_vector(owner, f"{side} limit", values, finite=False)
            for side, values in (("lower", rows.lower), ("upper", rows.upper))
        )
        if len(lower) != len(upper):
            raise InputError(
                f"{owner}: {len(lower)} lower limits and {len(upper)} upper ones: give "
                "-inf below and inf above where there is no limit"
            )
        _check_sides(owner, lower, upper)
        if isinstance(rows, Bounds):
            return Bounds(rows.variable, lower, upper)
        blocks = uniform_blocks(owner, rows.blocks, len(lower))
        check_structure(owner, rows.tags, blocks, self.scene.laplace)
        return LinearRows(blocks, lower, upper, rows.tags)


def _uniform_cones(owner: str, rows: ConeRows) -> ConeRows:
    offset = uniform_vector(owner, "offset", rows.offset, finite=True)
    if sum(rows.sizes) != len(offset) or min(rows.sizes, default=1) < 1:
        raise InputError(
            f"{owner}: cones of {sum(rows.sizes)} rows in all, and {len(offset)} "
            "offsets: give the rows of one cone after the other"
        )
    return ConeRows(uniform_blocks(owner, rows.blocks, len(offset)), offset, rows.sizes)


def _check_sides(owner: str, lower: Array, upper: Array) -> None:
    """Refuse limits that are infinite on the wrong side."""
    for name, wrong in (("lower", lower == np.inf), ("upper", upper == -np.inf)):
        if wrong.any():
            raise InputError(
                f"{owner}: {int(wrong.sum())} {name} limits are infinite on the wrong "
                "side, so that no value satisfies them: use -inf below and inf above "
                "where there is no limit"
            )

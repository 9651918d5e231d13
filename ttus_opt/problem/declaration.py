"""A formulation: terms to minimise subject to constraints, over a scene."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, fields, replace
from functools import partial
from operator import methodcaller
from typing import Protocol

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.core.html_card import page, table
from ttus_opt.problem.constraints.base import Bounds, ConeRows, Constraint
from ttus_opt.problem.cvxpy_form import CvxpyProgram
from ttus_opt.problem.program import Program, in_words
from ttus_opt.problem.terms.base import Fitted, Term
from ttus_opt.problem.terms.structure import (
    KnownCovariance,
    LaplaceRows,
    Tag,
    declared,
)


class Unplaced(Protocol):
    """A term without a scene, such as `ttus_opt.problem.terms.cvxpy_term.CvxpyTerm`."""

    def over(self, scene: Scene) -> Term:
        """The term over a scene."""


@dataclass(frozen=True)
class Search:
    """A parameter of a formulation that is found by a search over convex fits.

    Attributes:
        parameter: Its name.
        low: Least value.
        high: Largest value.
        build: The convex formulation for a given value; one with a search of its own is
            searched next, at the value found.
        neutral: Value where the data do not determine the parameter; None for 0, or the
            limit nearest to it.
        likely: An estimate; the search of the whole range is omitted where the minimum
            is found beside it.
    """

    parameter: str
    low: float
    high: float
    build: Callable[[float], Formulation] = field(repr=False)
    neutral: float | None = None
    likely: float | None = None

    def __post_init__(self) -> None:
        """Validate finite limits in order, with the neutral value between them."""
        if not (math.isfinite(self.low) and self.low < self.high < math.inf):
            raise InputError(
                f"{self.parameter} needs a range low < high, got {self.low} to "
                f"{self.high}"
            )
        if not self.low <= self.neutral_value <= self.high:
            raise InputError(
                f"the neutral value of {self.parameter} must lie in [{self.low:g}, "
                f"{self.high:g}], got {self.neutral:g}"
            )

    @property
    def neutral_value(self) -> float:
        """Value where the data do not determine the parameter."""
        nearest = min(max(0.0, self.low), self.high)
        return nearest if self.neutral is None else self.neutral

    def __str__(self) -> str:
        return f"searching {self.parameter} in [{self.low:g}, {self.high:g}]"

    def then(self, change: Callable[[Formulation], Formulation]) -> Search:
        """The same search over changed formulations."""
        return replace(self, build=partial(_changed, self.build, change))


def _changed(
    build: Callable[[float], Formulation],
    change: Callable[[Formulation], Formulation],
    value: float,
) -> Formulation:
    """By name instead of within `Search.then`, which could not be pickled."""
    return change(build(value))


@dataclass(frozen=True, init=False, repr=False, eq=False)
class Formulation:
    """Minimise the sum of the terms subject to the constraints.

    A formulation is immutable; ``+`` and the methods ``with_…`` return new ones.

    Attributes:
        terms: Weighted terms of the objective. One without a scene gets that of the
            others.
        constraints: Constraints.
        name: For reports.
        search: A parameter to search for; the terms are those of a first guess.
    """

    terms: tuple[Term, ...]
    constraints: tuple[Constraint, ...]
    name: str
    search: Search | None

    def __init__(
        self,
        terms: Iterable[Term | Unplaced],
        constraints: Iterable[Constraint] = (),
        name: str = "user",
        search: Search | None = None,
    ) -> None:
        """Collect terms and constraints.

        Raises:
            InputError: No terms, names used twice, or members of different scenes.
        """
        given = (_placed(terms), tuple(constraints), name, search)
        for part, value in zip(fields(self), given, strict=True):
            object.__setattr__(self, part.name, value)
        members: list[Term | Constraint] = [*self.terms, *self.constraints]
        names = [member.name for member in members]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise InputError(
                f"{', '.join(twice)} appears twice in the formulation: change the "
                "weight of the one that is there (with_weights)"
            )
        if any(member.scene is not self.scene for member in members):
            raise InputError("all terms and constraints must be of the same scene")

    @property
    def scene(self) -> Scene:
        """The scene its members are made from."""
        return self.terms[0].scene

    def __add__(self, term: Term | Unplaced) -> Formulation:
        """The formulation with one more term."""
        if not (isinstance(term, Term) or hasattr(term, "over")):
            return NotImplemented
        return self._changed(
            (*self.terms, term), self.constraints, methodcaller("__add__", term)
        )

    def with_constraints(self, *constraints: Constraint) -> Formulation:
        """The formulation with more constraints."""
        return self._changed(
            self.terms,
            (*self.constraints, *constraints),
            methodcaller("with_constraints", *constraints),
        )

    def with_weights(self, **weights: float) -> Formulation:
        """The formulation with other weights by term name; nothing is assembled again.

        Raises:
            InputError: Unknown term, or a negative weight.
        """
        known = [term.name for term in self.terms]
        for name in weights:
            if name not in known:
                raise InputError(f"no term {name!r}, there are {', '.join(known)}")
        return self._changed(
            (t.with_weight(weights.get(t.name, t.weight)) for t in self.terms),
            self.constraints,
            methodcaller("with_weights", **weights),
        )

    def named(self, name: str) -> Formulation:
        """Under another name."""
        return replace(self, name=name)

    def with_search(self, search: Search) -> Formulation:
        """The formulation with a parameter to search for."""
        return replace(self, search=search)

    def _changed(
        self,
        terms: Iterable[Term | Unplaced],
        constraints: Iterable[Constraint],
        change: Callable[[Formulation], Formulation],
    ) -> Formulation:
        search = None if self.search is None else self.search.then(change)
        return Formulation(terms, constraints, self.name, search)

    def compile(self) -> Program:
        """The matrices with named rows.

        Raises:
            InputError: A term takes a variable that no other member has.
        """
        for term in self.terms:
            if not term.takes:
                continue
            others = (t.assembled.blocks for t in self.terms if t is not term)
            known = {"p"}.union(*others)
            unknown = [name for name in term.takes if name not in known]
            if unknown:
                raise InputError(
                    f"term {term.name} takes {unknown[0]}, a variable of no other "
                    f"term, and would have no effect: there are "
                    f"{', '.join(sorted(known))}"
                )
        return Program.build(self.scene, self.terms, self.constraints)

    @property
    def scene_parameters(self) -> Mapping[str, float]:
        """Parameters of the scene, by name; none if its boundary values are not used.

        A prior with a mean of its own uses none.
        """
        tags = [term.assembled.tags for term in self.terms]
        chosen = any(Tag.OWN_MEAN in t or declared(t, KnownCovariance) for t in tags)
        scenes = any(declared(t, LaplaceRows) and Tag.OWN_MEAN not in t for t in tags)
        return {} if chosen and not scenes else self.scene.parameters

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """Parameters that a solution identifies, by name.

        Args:
            values: The solution's variables by name.
        """
        found = dict(self.scene_parameters)
        for term in self.terms:
            found |= term.parameters(values)
        return found

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """Those of its `parameters` that are variables of the program, by name.

        Args:
            values: The solution's variables by name.
        """
        columns: dict[str, Fitted] = {}
        for term in self.terms:
            columns |= term.fitted(values)
        return columns

    def not_identifiable(self) -> dict[str, str]:
        """Why parameters are not determined by any row, by name."""
        reasons: dict[str, str] = {}
        for term in self.terms:
            if term.weight > 0.0:
                reasons |= term.not_identifiable()
        return reasons

    def without(self, *names: str) -> Formulation:
        """Without some of the terms and constraints.

        Raises:
            InputError: Unknown name, or no term would be left.
        """
        known = [term.name for term in self.terms]
        known += [constraint.name for constraint in self.constraints]
        for name in names:
            if name not in known:
                near = difflib.get_close_matches(name, known, n=1)
                raise InputError(
                    f"no term or constraint {name!r}, there are {', '.join(known)}"
                    + (f": did you mean {near[0]}?" if near else "")
                )
        return self._changed(
            [t for t in self.terms if t.name not in names],
            [c for c in self.constraints if c.name not in names],
            methodcaller("without", *names),
        )

    def to_cvxpy(self) -> CvxpyProgram:
        """The problem in cvxpy, for further use.

        Returns:
            ``problem`` with its ``variables`` and ``constraints`` by name. Its solution
            is not verified by this package. A searched parameter has the value of the
            first guess.
        """
        return CvxpyProgram.of(self.compile())

    def with_neutral(self, names: Collection[str]) -> Formulation:
        """The formulation with these parameters fixed at their neutral values.

        Bounds of variables that no term uses any more are dropped.
        """
        if not names:
            return self
        terms = [term.with_neutral(names) for term in self.terms]
        left = {name for term in terms for name in term.assembled.blocks}
        kept = [c for c in self.constraints if _concerns(c, left)]
        return self._changed(terms, kept, methodcaller("with_neutral", tuple(names)))

    def __repr__(self) -> str:
        """Its members in one line; `str` gives the mathematics."""
        sums = " + ".join(f"{term.weight:g} {term.name}" for term in self.terms)
        limits = ", ".join(constraint.name for constraint in self.constraints)
        sums += f" subject to {limits}" if limits else ""
        return f"<Formulation {self.name} over {self._over()}: {sums}>"

    def __str__(self) -> str:
        """The mathematics with sizes and weights, a line for each member."""
        lines = [
            f"  {how} {formula}    [{name}: {size}]"
            for how, formula, name, size in self._members()
        ]
        if self.search is not None:
            lines.append(f"  {self.search}")
        return "\n".join([f"{self.name}: minimise over {self._over()}", *lines])

    def _repr_html_(self) -> str:
        """The same as a table, for notebooks."""
        rows = [[how.strip("+ ·"), *rest] for how, *rest in self._members()]
        notes = [] if self.search is None else [str(self.search)]
        heads = ["weight", "", "name", "size"]
        return page(
            self.name, [f"minimise over {self._over()}", *notes], table(heads, rows)
        )

    def _over(self) -> str:
        """The variables and their sizes."""
        sizes = {"p": self.scene.n_voxels}
        for term in self.terms:
            blocks = term.assembled.blocks.items()
            sizes |= {name: M.shape[1] for name, M in blocks}
        return in_words(sizes)

    def _members(self) -> list[tuple[str, str, str, str]]:
        """Weight or role, mathematics, name and size of every term and constraint."""
        terms = [
            (
                f"+ {t.weight:g} ·",
                t.formula,
                t.name,
                f"{len(t.assembled.target):,} rows",
            )
            for t in self.terms
        ]
        return terms + [
            ("subject to", c.formula, c.name, _size(c)) for c in self.constraints
        ]


def _placed(terms: Iterable[Term | Unplaced]) -> tuple[Term, ...]:
    """The terms, all with a scene; at least one must have one."""
    given = tuple(terms)
    if not given:
        raise InputError("a formulation needs at least one term")
    scene = next((t.scene for t in given if isinstance(t, Term)), None)
    if scene is None:
        raise InputError("a formulation needs at least one term of a scene")
    return tuple(t if isinstance(t, Term) else t.over(scene) for t in given)


def _size(constraint: Constraint) -> str:
    """Number of rows, cones or bounds of a constraint."""
    rows = constraint.assembled
    if isinstance(rows, Bounds):
        finite = np.isfinite(rows.lower) | np.isfinite(rows.upper)
        return f"{int(finite.sum()):,} bounds"
    if isinstance(rows, ConeRows):
        return f"{len(rows.sizes):,} cones"
    return f"{len(rows.lower):,} rows"


def _concerns(constraint: Constraint, variables: Collection[str]) -> bool:
    rows = constraint.assembled
    return not isinstance(rows, Bounds) or rows.variable in variables

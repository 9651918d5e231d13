"""A formulation: terms to minimise subject to constraints, over a scene.

``formulations/<name>.py`` and users' own files hold ``build(scene, **options)``
that returns one; `load` finds them by name or path.
"""

from __future__ import annotations

import difflib
import importlib
import importlib.util
import inspect
import math
import pkgutil
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.arrays import Array
from ttus_opt.constraints.base import Bounds, Constraint
from ttus_opt.errors import InputError, TtusError
from ttus_opt.problem.program import Program
from ttus_opt.scene import Scene
from ttus_opt.terms.base import Fitted, Term


@dataclass(frozen=True)
class Search:
    """One number of a formulation that is found by a search over convex fits.

    Attributes:
        parameter: Its name.
        low: Least value.
        high: Largest value.
        build: The formulation for a given value, convex in all the rest; one with
            a search of its own is searched next, at the value found.
        neutral: What is used where the data do not bear the parameter; by default 0,
            or the limit nearest to it.
    """

    parameter: str
    low: float
    high: float
    build: Callable[[float], Formulation] = field(repr=False)
    neutral: float = math.nan

    def __post_init__(self) -> None:
        """Refuse an empty range.

        Raises:
            InputError: The limits are not finite or out of order, or the neutral
                value is not between them.
        """
        if not (math.isfinite(self.low) and self.low < self.high < math.inf):
            raise InputError(
                f"{self.parameter} needs a range low < high, got {self.low} to "
                f"{self.high}"
            )
        if math.isnan(self.neutral):
            nearest = min(max(0.0, self.low), self.high)
            object.__setattr__(self, "neutral", nearest)
        if not self.low <= self.neutral <= self.high:
            raise InputError(
                f"the neutral value of {self.parameter} must lie in [{self.low:g}, "
                f"{self.high:g}], got {self.neutral:g}"
            )

    def then(self, change: Callable[[Formulation], Formulation]) -> Search:
        """The same search over changed formulations."""
        build = self.build
        return replace(self, build=lambda value: change(build(value)))


@dataclass(frozen=True)
class Formulation:
    """Minimise the sum of the terms subject to the constraints.

    Attributes:
        terms: What is minimised, each with its weight.
        constraints: What must hold.
        name: For reports.
        search: A number to search for beside; the terms are those of a first guess.
    """

    terms: tuple[Term, ...]
    constraints: tuple[Constraint, ...] = ()
    name: str = "user"
    search: Search | None = None

    def __init__(
        self,
        terms: Iterable[Term],
        constraints: Iterable[Constraint] = (),
        name: str = "user",
        search: Search | None = None,
    ) -> None:
        """Collect terms and constraints.

        Raises:
            InputError: No terms, names used twice, or members of different scenes.
        """
        object.__setattr__(self, "terms", tuple(terms))
        object.__setattr__(self, "constraints", tuple(constraints))
        object.__setattr__(self, "name", name)
        object.__setattr__(self, "search", search)
        if not self.terms:
            raise InputError("a formulation needs at least one term")
        members: list[Term | Constraint] = [*self.terms, *self.constraints]
        names = [member.name for member in members]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise InputError(
                f"{', '.join(twice)} appears twice in the formulation: change the "
                "weight of the one that is there (with_weights)"
            )
        if any(member.scene is not self.scene for member in members):
            raise InputError("all terms and constraints must speak of the same scene")

    @property
    def scene(self) -> Scene:
        """The scene it speaks of."""
        return self.terms[0].scene

    def __add__(self, term: Term) -> Formulation:
        """With one more term."""
        return self._changed(
            (*self.terms, term), self.constraints, lambda built: built + term
        )

    def with_constraints(self, *constraints: Constraint) -> Formulation:
        """With more constraints."""
        return self._changed(
            self.terms,
            (*self.constraints, *constraints),
            lambda built: built.with_constraints(*constraints),
        )

    def with_weights(self, **weights: float) -> Formulation:
        """With other weights by term name; nothing is assembled again.

        Raises:
            InputError: No term has that name, or a weight is negative.
        """
        known = [term.name for term in self.terms]
        for name in weights:
            if name not in known:
                raise InputError(f"no term {name!r}, there are {', '.join(known)}")
        return self._changed(
            (t.with_weight(weights.get(t.name, t.weight)) for t in self.terms),
            self.constraints,
            lambda built: built.with_weights(**weights),
        )

    def named(self, name: str) -> Formulation:
        """Under another name."""
        return Formulation(self.terms, self.constraints, name, self.search)

    def with_search(self, search: Search) -> Formulation:
        """With a number to search for beside."""
        return Formulation(self.terms, self.constraints, self.name, search)

    def _changed(
        self,
        terms: Iterable[Term],
        constraints: Iterable[Constraint],
        change: Callable[[Formulation], Formulation],
    ) -> Formulation:
        search = None if self.search is None else self.search.then(change)
        return Formulation(terms, constraints, self.name, search)

    def compile(self) -> Program:
        """The matrices with named rows."""
        return Program.build(self.scene, self.terms, self.constraints)

    def parameters(self, values: Mapping[str, Array]) -> dict[str, float]:
        """What a solution identifies beside the field, by name.

        Args:
            values: The solution's variables by name.
        """
        found = dict(self.scene.parameters)
        for term in self.terms:
            found |= term.parameters(values)
        return found

    def fitted(self, values: Mapping[str, Array]) -> dict[str, Fitted]:
        """Those of its `parameters` that are found among the variables, by name.

        Args:
            values: The solution's variables by name.
        """
        found: dict[str, Fitted] = {}
        for term in self.terms:
            found |= term.fitted(values)
        return found

    def unborne(self) -> dict[str, str]:
        """Parameters of which no row says anything, and why, by name."""
        found: dict[str, str] = {}
        for term in self.terms:
            if term.weight > 0.0:
                found |= term.unborne()
        return found

    def without(self, names: Collection[str]) -> Formulation:
        """With these parameters at their neutral values, known and not fitted.

        Bounds of a variable that no term has any more are left out.
        """
        if not names:
            return self
        terms = [term.without(names) for term in self.terms]
        left = {name for term in terms for name in term.assembled.blocks}
        kept = [c for c in self.constraints if _speaks_of(c, left)]
        return self._changed(terms, kept, lambda built: built.without(names))

    def __repr__(self) -> str:
        """The mathematics with sizes and weights."""
        sizes = dict.fromkeys(["p"], self.scene.n_voxels)
        lines = []
        for term in self.terms:
            rows = term.assembled
            sizes |= {name: M.shape[1] for name, M in rows.blocks.items()}
            lines.append(
                f"  + {term.weight:g} · {term.formula}    "
                f"[{term.name}: {len(rows.target):,} rows]"
            )
        for constraint in self.constraints:
            given = constraint.assembled
            if isinstance(given, Bounds):
                finite = np.isfinite(given.lower) | np.isfinite(given.upper)
                count = f"{int(finite.sum()):,} bounds"
            else:
                count = f"{len(given.lower):,} rows"
            lines.append(
                f"  subject to {constraint.formula}    [{constraint.name}: {count}]"
            )
        if self.search is not None:
            lines.append(
                f"  searching {self.search.parameter} in "
                f"[{self.search.low:g}, {self.search.high:g}]"
            )
        over = ", ".join(f"{name} in R^{size:,}" for name, size in sizes.items())
        return "\n".join([f"{self.name}: minimise over {over}", *lines])


@dataclass(frozen=True)
class FormulationInfo:
    """One line about a formulation file.

    Attributes:
        name: By which `load` finds it.
        summary: First line of its docstring.
        options: Its options with their defaults.
    """

    name: str
    summary: str
    options: Mapping[str, Any]


def available() -> list[FormulationInfo]:
    """The formulations that come with the package."""
    return [
        _info(name, _build_function(importlib.import_module(f"formulations.{name}")))
        for name in _names()
    ]


def load(
    formulation: str | Path | Formulation, scene: Scene, **options: Any
) -> Formulation:
    """Get a formulation by name, by path to a file, or as it is.

    Args:
        formulation: A name (``"eq10"``), a path ending in ``.py``, or an object.
        scene: The scene to build it over.
        options: What its ``build`` takes beside the scene.

    Returns:
        The formulation.

    Raises:
        InputError: Unknown name or option, words for a number, or a file without
            ``build``.
    """
    if isinstance(formulation, Formulation):
        if options:
            raise InputError(
                f"{', '.join(options)} cannot be given to a finished formulation: use "
                "with_weights, or name the formulation instead"
            )
        return formulation
    build, name = _find(formulation)
    known = _options(build)
    for option, value in options.items():
        if known is not None and option not in known:
            raise InputError(
                f"formulation {name} has no option {option!r}, it has "
                f"{', '.join(known) or 'none'}"
            )
        if known is not None:
            _check_option(
                f"option {option} of formulation {name}", known[option], value
            )
    try:
        built = build(scene, **options)
    except TtusError:
        raise
    except Exception as error:
        error.add_note(f"raised by build() of formulation {name} ({formulation})")
        raise
    if not isinstance(built, Formulation):
        raise InputError(
            f"build() of formulation {name} returned {type(built).__name__}, expected "
            "a Formulation"
        )
    return built.named(name)


def _check_option(what: str, usual: Any, value: Any) -> None:
    """Refuse a word for a number, and a count that is none.

    Raises:
        InputError: The value is not of its default's kind; a default of None stands
            for a number that is found by itself.
    """
    if isinstance(value, str) and (usual is None or isinstance(usual, int | float)):
        such = "" if usual is None else f" such as {usual}"
        raise InputError(f"{what} takes a number{such}, got {value!r}")
    counts = isinstance(usual, int) and not isinstance(usual, bool)
    if counts and not (isinstance(value, int | float | np.integer) and value % 1 == 0):
        raise InputError(f"{what} takes a whole number such as {usual}, got {value}")


def _speaks_of(constraint: Constraint, variables: Collection[str]) -> bool:
    rows = constraint.assembled
    return not isinstance(rows, Bounds) or rows.variable in variables


def _find(formulation: str | Path) -> tuple[Callable[..., Formulation], str]:
    path = Path(formulation)
    if path.suffix == ".py":
        if not path.exists():
            raise InputError(f"formulation file not found: {path}: check the path")
        spec = importlib.util.spec_from_file_location(path.stem, path)
        if spec is None or spec.loader is None:
            raise InputError(f"{path} cannot be loaded as a Python file")
        module = importlib.util.module_from_spec(spec)
        try:
            spec.loader.exec_module(module)
        except Exception as error:
            error.add_note(f"raised while loading formulation file {path}")
            raise
        return _build_function(module), path.stem
    names = _names()
    if str(formulation) not in names:
        near = difflib.get_close_matches(str(formulation), names, n=3, cutoff=0.4)
        raise InputError(
            f"unknown formulation {str(formulation)!r}, "
            f"{'did you mean ' if near else 'there are '}"
            f"{', '.join(near or names)}? A file of your own ends in .py"
        )
    module = importlib.import_module(f"formulations.{formulation}")
    return _build_function(module), str(formulation)


def _names() -> list[str]:
    # by name: the shelf imports this package, not the other way round
    shelf = importlib.import_module("formulations")
    return sorted(m.name for m in pkgutil.iter_modules(shelf.__path__))


def _build_function(module: Any) -> Callable[..., Formulation]:
    build = getattr(module, "build", None)
    if not callable(build):
        raise InputError(
            f"formulation file {getattr(module, '__file__', module)} has no function "
            "build(scene, **options)"
        )
    return build  # type: ignore[no-any-return]


def _options(build: Callable[..., Formulation]) -> dict[str, Any] | None:
    """Options with defaults; None where the function takes any keyword."""
    parameters = list(inspect.signature(build).parameters.values())[1:]
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return None
    return {p.name: p.default for p in parameters}


def _info(name: str, build: Callable[..., Formulation]) -> FormulationInfo:
    doc = inspect.getdoc(inspect.getmodule(build)) or ""
    return FormulationInfo(name, doc.partition("\n")[0].strip(), _options(build) or {})

"""Formulations by name, by path or by object.

``formulations/<name>.py`` and users' own files hold ``build(scene, **options)`` that
returns a `Formulation`; another package offers its own by an entry point of the group
``ttus_opt.formulations``. `load` finds them.
"""

from __future__ import annotations

import importlib.metadata
import inspect
import math
import pkgutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.core.errors import InputError
from ttus_opt.core.plugins import (
    formulation_module,
    formulations,
    module_of_file,
    unknown_name,
    user_errors,
)
from ttus_opt.problem.declaration import Formulation as Formulation
from ttus_opt.problem.declaration import Search as Search

#: Fitted when none is named and none can be chosen
DEFAULT = "eq10"

#: Where another package offers formulations
ENTRY_POINTS = "ttus_opt.formulations"


#: Largest option, and inverse of the least positive one: sums of squares over a million
#: rows then stay far within the range of a double
LARGEST = 1e15


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
    """The formulations of this package, and those that others offer."""
    return [_info(name, _build_of(name)) for name in sorted({*_names(), *_elsewhere()})]


def load(
    formulation: str | Path | Formulation, scene: Scene, **options: Any
) -> Formulation:
    """Get a formulation by name, by path to a file, or as it is.

    Args:
        formulation: A name (``"eq10"``), a path ending in ``.py``, or an object.
        scene: The scene to build it over.
        options: Further arguments of its ``build``.

    Returns:
        The formulation.

    Raises:
        InputError: Unknown name or option, an option of the wrong kind, a file without
            ``build``, or a formulation over another scene.
    """
    if isinstance(formulation, Formulation):
        if options:
            raise InputError(
                f"{', '.join(options)} cannot be given to a finished formulation: use "
                "with_weights, or name the formulation instead"
            )
        return _over(scene, formulation)
    build, name = _find(formulation)
    known = _options(build)
    for option, value in options.items():
        if known is not None and option not in known:
            raise InputError(
                f"formulation {name} has no option {option!r}, it has "
                f"{', '.join(known) or 'none'}"
            )
        if known is not None:
            what = f"option {option} of formulation {name}"
            _check_option(what, known[option], value)
    with user_errors(f"build() of formulation {name}"):
        built = build(scene, **options)
    if not isinstance(built, Formulation):
        raise InputError(
            f"build() of formulation {name} returned {type(built).__name__}, expected "
            "a Formulation"
        )
    return _over(scene, built.named(name))


def _over(scene: Scene, declared: Formulation) -> Formulation:
    if declared.scene is not scene:
        raise InputError(
            "the formulation belongs to another scene: build it for this one"
        )
    return declared


#: As `ttus_opt` calls it
load_formulation = load


def option_defaults(formulation: str | Path) -> dict[str, Any] | None:
    """A formulation's options with their defaults; None where it takes any.

    Raises:
        InputError: There is no such formulation.
    """
    known = _options(_find(formulation)[0])
    return None if known is None else {name: p.default for name, p in known.items()}


def _check_option(what: str, parameter: inspect.Parameter, value: Any) -> None:
    """Refuse an option whose kind differs from its default and annotation."""
    usual = parameter.default
    such = "" if usual is None else f" such as {usual}"
    words = str(parameter.annotation)  # which may be text itself
    says_number = "float" in words or "int" in words
    if usual is None and (value is None or not says_number):
        return  # estimated from the data, or of a kind that only ``build`` knows
    if isinstance(usual, bool):
        fits, kind = isinstance(value, bool), "true or false"
    elif isinstance(usual, str):
        fits, kind = isinstance(value, str), f"a word{such}"
    elif usual is None or isinstance(usual, int | float):
        whole = isinstance(usual, int)
        fits = _is_number(value) and not (whole and value % 1 != 0)
        kind = f"a whole number{such}" if whole else f"a number{such}"
    else:
        return
    if not fits:
        raise InputError(f"{what} takes {kind}, got {value!r}")
    if _is_number(value) and LARGEST < abs(value) < math.inf:
        raise InputError(f"{what} takes {kind}, up to {LARGEST:g}, got {value!r}")
    if _is_number(value) and 0.0 < abs(value) < 1.0 / LARGEST:
        least = f"0 or at least {1.0 / LARGEST:g}"
        raise InputError(f"{what} takes {kind}, {least}, got {value!r}")


def _is_number(value: Any) -> bool:
    """Whether it is a real number; NaN and truth values are not."""
    real = isinstance(value, int | float | np.integer | np.floating)
    return real and not isinstance(value, bool) and not math.isnan(value)


def _find(formulation: str | Path) -> tuple[Callable[..., Formulation], str]:
    path = Path(formulation)
    if path.suffix == ".py":
        formulations()  # it may import one of ours
        return _build_function(module_of_file(path, "formulation")), path.stem
    return _build_of(str(formulation)), str(formulation)


def _build_of(name: str) -> Callable[..., Formulation]:
    """The function of a formulation by name, ours before another package's."""
    ours = _names()
    if name in ours:
        return _build_function(formulation_module(name))
    others = _elsewhere()
    if name not in others:
        raise unknown_name("formulation", name, [*ours, *others])
    with user_errors(f"formulation {name} of another package"):
        found = others[name].load()
    return _build_function(found) if inspect.ismodule(found) else _checked(found, name)


def _names() -> list[str]:
    return sorted(m.name for m in pkgutil.iter_modules(formulations().__path__))


def _elsewhere() -> dict[str, importlib.metadata.EntryPoint]:
    """Formulations of other packages, which name a module or a function ``build``."""
    return {e.name: e for e in importlib.metadata.entry_points(group=ENTRY_POINTS)}


def _checked(build: Any, name: str) -> Callable[..., Formulation]:
    if not callable(build):
        raise InputError(
            f"entry point {name} of {ENTRY_POINTS} must be a module with build() or "
            f"that function, got {type(build).__name__}"
        )
    return build  # type: ignore[no-any-return]


def _build_function(module: Any) -> Callable[..., Formulation]:
    build = getattr(module, "build", None)
    if not callable(build):
        raise InputError(
            f"formulation file {getattr(module, '__file__', module)} has no function "
            "build(scene, **options)"
        )
    return build  # type: ignore[no-any-return]


def _options(
    build: Callable[..., Formulation],
) -> dict[str, inspect.Parameter] | None:
    """Options by name; None where the function takes any keyword."""
    parameters = list(inspect.signature(build).parameters.values())[1:]
    if any(p.kind is p.VAR_KEYWORD for p in parameters):
        return None
    return {p.name: p for p in parameters}


def _info(name: str, build: Callable[..., Formulation]) -> FormulationInfo:
    doc = inspect.getdoc(inspect.getmodule(build)) or ""
    options = {k: p.default for k, p in (_options(build) or {}).items()}
    return FormulationInfo(name, doc.partition("\n")[0].strip(), options)

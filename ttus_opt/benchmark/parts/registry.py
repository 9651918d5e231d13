"""The parts of the benchmark, discovered in this folder."""

from __future__ import annotations

import functools
import importlib
import pkgutil

import ttus_opt.benchmark.parts
from ttus_opt.benchmark.parts.base import Part
from ttus_opt.core.errors import InputError

#: The first part, and the default
SOLVERS = "solvers"


@functools.cache
def parts() -> dict[str, Part]:
    """Every part by name."""
    listed: list[Part] = []
    for module in pkgutil.iter_modules(ttus_opt.benchmark.parts.__path__):
        loaded = importlib.import_module(f"ttus_opt.benchmark.parts.{module.name}")
        listed += [loaded.PART] if hasattr(loaded, "PART") else []
    listed.sort(key=lambda part: (part.name != SOLVERS, part.name))
    return {part.name: part for part in listed}


def chosen(text: str) -> list[str]:
    """Names of parts, each once, from a comma-separated list or "all".

    Raises:
        InputError: An empty list, or an unknown name.
    """
    known = list(parts())
    names = [name.strip() for name in text.split(",") if name.strip()]
    if names == ["all"]:
        return known
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise InputError(
            f"unknown part {', '.join(unknown) or text!r}: choose from "
            f"{', '.join(known)}, or all"
        )
    return list(dict.fromkeys(names))

"""Optional packages: imported where used, with a clear error when missing."""

from __future__ import annotations

import importlib
import importlib.metadata
import re
from collections import Counter
from types import ModuleType
from typing import Any

from ttus_opt.core.errors import InputError, MissingPackageError


def load(module: str, extra: str) -> ModuleType:
    """Import a package that an extra of ttus-opt installs.

    Args:
        module: Import name, such as ``skfem``.
        extra: The extra that installs it, such as ``phantom``.

    Raises:
        MissingPackageError: It is not installed; the message says how to install it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.split(".")[0]:
            raise
        raise MissingPackageError(
            f'{error.name} is not installed: pip install "ttus-opt[{extra}]"'
        ) from error


def version_of(package: str) -> str:
    """Version of an installed package; "unknown" of another, or of a plain checkout."""
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "unknown"


def extra_with(module: str) -> str | None:
    """The smallest extra that installs a package of a module's name, if any."""
    required = importlib.metadata.requires("ttus-opt") or []
    needs = (re.match(r"([\w.-]+).*extra == ['\"](\w+)", line) for line in required)
    pairs = [(n[1].lower().replace("-", "_"), n[2]) for n in needs if n]
    sizes = Counter(extra for _, extra in pairs)
    name = module.split(".")[0].lower()
    having = [extra for package, extra in pairs if package == name]
    return min(having, key=sizes.__getitem__, default=None)


def dask_client(address: str) -> Any:
    """A client of the dask scheduler at an address (host:port); use it in ``with``.

    Raises:
        MissingPackageError: dask is not installed.
        InputError: No scheduler answers.
    """
    distributed = load("distributed", "parallel")
    try:
        return distributed.Client(address, timeout="10s")
    except (OSError, ValueError) as error:
        raise InputError(f"no dask scheduler answers at {address}: {error}") from error

"""Packages that only some work needs: loaded where used, told by name when missing."""

from __future__ import annotations

import importlib
from types import ModuleType

from ttus_opt.errors import MissingPackageError


def load(module: str, extra: str) -> ModuleType:
    """A package that an extra of ttus-opt installs.

    Args:
        module: Import name, such as ``skfem``.
        extra: The extra that has it, such as ``phantom``.

    Returns:
        The module.

    Raises:
        MissingPackageError: It is not installed; the message says how to get it.
    """
    try:
        return importlib.import_module(module)
    except ModuleNotFoundError as error:
        if error.name != module.split(".")[0]:
            raise
        raise MissingPackageError(
            f'{error.name} is not installed: pip install "ttus-opt[{extra}]"'
        ) from error

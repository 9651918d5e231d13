"""Find and import the formulations that come with the package.

In a checkout they are in ``formulations/`` beside the package, in an installed wheel in
``ttus_opt/formulations/``. Both are imported as ``ttus_opt.formulations``, and also as
``formulations`` unless a user's own file or folder has that name.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from ttus_opt.core.errors import FileError

NAME, SHORT = "ttus_opt.formulations", "formulations"


@functools.cache
def shelf() -> ModuleType:
    """The package that contains the formulations.

    Raises:
        FileError: It is in neither place.
    """
    if NAME in sys.modules:
        return sys.modules[NAME]
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "formulations", package.parent / "formulations"):
        first = folder / "__init__.py"
        if not first.is_file():
            continue
        spec = importlib.util.spec_from_file_location(
            NAME, first, submodule_search_locations=[str(folder)]
        )
        assert spec is not None
        assert spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        sys.modules[NAME] = module
        spec.loader.exec_module(module)
        if importlib.util.find_spec(SHORT) is None:
            sys.modules[SHORT] = module
        return module
    raise FileError(
        f"the formulations are not next to {package}: install ttus-opt again, or run "
        "from a whole checkout"
    )


def formulation_module(name: str) -> ModuleType:
    """Import a formulation by the name of its file, without the suffix."""
    return importlib.import_module(f"{shelf().__name__}.{name}")

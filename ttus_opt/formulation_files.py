"""Where the formulations that come with the package lie.

In a checkout they are the folder ``formulations/`` beside the package, in an installed
wheel ``ttus_opt/formulations/``. Both are imported as ``ttus_opt.formulations``, and as
``formulations`` too where nothing else has that name: a user's own file or folder of
that name is never taken for them.
"""

from __future__ import annotations

import functools
import importlib
import importlib.util
import sys
from pathlib import Path
from types import ModuleType

from ttus_opt.errors import FileError

NAME, SHORT = "ttus_opt.formulations", "formulations"


@functools.cache
def shelf() -> ModuleType:
    """The package of the formulations.

    Raises:
        FileError: They are in neither place.
    """
    if NAME in sys.modules:  # imported by its name before
        return sys.modules[NAME]
    package = Path(__file__).resolve().parent
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
    """One of them, imported.

    Args:
        name: Of the file, without its suffix.
    """
    return importlib.import_module(f"{shelf().__name__}.{name}")

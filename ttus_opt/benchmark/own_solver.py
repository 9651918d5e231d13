"""A user's own solver on its way to the process of a run: by path, or as an object.

An object is sent pickled, so its class must be importable there. A file is named with a
digest of its text, so that rows of another version are not taken for this one's.
"""

from __future__ import annotations

import base64
import hashlib
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from ttus_opt.errors import InputError
from ttus_opt.solvers.base import Solver
from ttus_opt.solvers.registry import asked_for, solvers

#: Among solvers: what `tt.fit` takes where none is named
AUTO: Literal["auto"] = "auto"


def options_of(given: str | Path | Solver) -> dict[str, Any]:
    """What a run's options say of a solver: its name, and where an own one is.

    Args:
        given: A name, `AUTO`, the path of a file with ``SOLVERS``, or a solver.

    Returns:
        ``solver``, and for an own one ``own``: plain data, for JSON.

    Raises:
        InputError: There is no such solver, it has a name of the shelf, or it cannot
            go to another process.
    """
    if given == AUTO:
        return {"solver": AUTO}
    solver = asked_for(given)
    if isinstance(given, str) and given in solvers():
        return {"solver": given}
    if solver is solvers().get(solver.name):
        return {"solver": solver.name}
    if solver.name in solvers():
        raise InputError(
            f"your solver has the name of one of the package's, {solver.name!r}: give "
            "it another name"
        )
    if isinstance(given, Solver):
        return {"solver": solver.name, "own": {"pickle": _pickled(given)}}
    path = Path(given).resolve()
    return {"solver": solver.name, "own": {"path": str(path), **version(path)}}


def solver_of(options: Mapping[str, Any]) -> Solver | Literal["auto"]:
    """The solver of a run's options, in whatever process."""
    own = options.get("own")
    if options["solver"] == AUTO:
        return AUTO
    if own is None:
        return asked_for(str(options["solver"]))
    if "path" in own:
        return asked_for(Path(own["path"]))
    found: Solver = pickle.loads(base64.b64decode(own["pickle"]))
    return found


def version(path: Path) -> dict[str, str]:
    """Tells one text of a user's file from another; nothing for a name."""
    if path.suffix != ".py" or not path.exists():
        return {}
    return {"version": hashlib.sha256(path.read_bytes()).hexdigest()[:12]}


def _pickled(solver: Solver) -> str:
    """The object as text; `InputError` where it or its class cannot travel."""
    name = type(solver).__qualname__
    if type(solver).__module__ == "__main__" or "<locals>" in name:
        raise InputError(
            f"solver {name} is defined in a script, notebook or function, which no "
            "other process can import: put it in a file and give its path"
        )
    try:
        return base64.b64encode(pickle.dumps(solver)).decode()
    except (pickle.PicklingError, TypeError, AttributeError) as error:
        raise InputError(
            f"solver {name} cannot be sent to another process: {error}: put it in a "
            "file and give its path"
        ) from error

"""Transfer of a user's own solver to the process of a run, by path or as an object.

An object is pickled, so its class must be importable there. A file is identified by a
digest of its text, so that rows of another version are not reused.
"""

from __future__ import annotations

import base64
import hashlib
import pickle
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

from ttus_opt.core.errors import InputError
from ttus_opt.solvers.base import Solver
from ttus_opt.solvers.registry import asked_for, solvers

#: The solver that `tt.fit` chooses by default
AUTO: Literal["auto"] = "auto"


def options_of(given: str | Path | Solver) -> dict[str, Any]:
    """A solver as options of a run: its name, and the source of an own one.

    Args:
        given: A name, `AUTO`, the path of a file with ``SOLVERS``, or a solver.

    Returns:
        ``solver``, and for an own one ``own``: plain data, for JSON.

    Raises:
        InputError: An unknown solver, an own one with the name of a built-in one, or
            one that cannot be sent to another process.
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
    """The solver from a run's options, in any process."""
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
    """Digest of a user's file; nothing for a name."""
    if path.suffix != ".py" or not path.exists():
        return {}
    return {"version": hashlib.sha256(path.read_bytes()).hexdigest()[:12]}


def _pickled(solver: Solver) -> str:
    """The object as text; `InputError` if it or its class cannot be pickled."""
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

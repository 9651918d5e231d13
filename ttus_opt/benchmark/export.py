"""The problems as files for other tools.

One MATLAB file per case and formulation, in the layout of the Maros-Meszaros
collection: minimise ½ xᵀP x + qᵀx + r subject to l ≤ A x ≤ u, bounds as rows at the
end, 1e20 for no limit. The same as .npz for readers without MATLAB support.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import scipy.io
import scipy.sparse as sp

from ttus_opt.core import io
from ttus_opt.core.errors import InputError
from ttus_opt.problem.program import Program
from ttus_opt.problem.reduction import reduce
from ttus_opt.solvers.packages.quadratic import TwoSided

#: Stands for "no limit" in such files
NO_LIMIT = 1e20


def export_program(program: Program, folder: Path, name: str) -> tuple[Path, Path]:
    """Write a program's sparse least-squares form.

    Args:
        program: Any program that can be stated as a QP.
        folder: Folder of the files.
        name: Stem of the files.

    Returns:
        MATLAB file, and NumPy archive with matrices in compressed columns.

    Raises:
        InputError: A penalty is not quadratic.
        FileError: The folder cannot be written to.
    """
    reduced = reduce(program).program
    if not reduced.is_quadratic:
        raise InputError(
            f"{name} has a group norm and is not a QP: leave it out of the export"
        )
    rows = TwoSided.of(reduced.least_squares_qp())
    # ½ ‖√2 u‖² is the whole objective: no constant beside it
    lower = np.maximum(rows.lower, -NO_LIMIT)
    upper = np.minimum(rows.upper, NO_LIMIT)
    matlab, archive = folder / f"{name}.mat", folder / f"{name}.npz"
    sizes: dict[str, Any] = {
        "n": rows.A.shape[1],
        "m": rows.A.shape[0],
        "n_original": program.n_variables,
    }
    content = {
        "P": sp.csc_matrix(rows.P),
        "q": rows.q.reshape(-1, 1),
        "r": 0.0,
        "A": rows.A,
        "l": lower.reshape(-1, 1),
        "u": upper.reshape(-1, 1),
        **sizes,
    }
    with io.replacing(matlab) as temporary:
        scipy.io.savemat(temporary, content, do_compression=True)
    with io.replacing(archive) as temporary:
        np.savez_compressed(
            temporary,
            q=rows.q,
            l=rows.lower,
            u=rows.upper,
            **{
                f"{letter}_{part}": getattr(matrix, part)
                for letter, matrix in (("P", rows.P), ("A", rows.A))
                for part in ("data", "indices", "indptr")
            },
            **sizes,
        )
    return matlab, archive

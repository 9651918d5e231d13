"""What terms and constraints declare must be numbers, said by the member's name."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array
from ttus_opt.errors import InputError


def check_declared(
    owner: str, blocks: Mapping[str, sp.csr_array], sides: Mapping[str, Array]
) -> None:
    """Refuse rows that no solver and no check could make sense of.

    Args:
        owner: What declares them, for the message.
        blocks: Matrix per variable.
        sides: Vectors with one entry per row, by what they are; limits may be
            infinite, targets not.

    Raises:
        InputError: Something is NaN, a number is infinite, or lengths differ.
    """
    for variable, matrix in blocks.items():
        wrong = ~np.isfinite(matrix.data)
        if wrong.any():
            at = int(np.flatnonzero(wrong)[0])
            row = int(np.searchsorted(matrix.indptr, at, side="right")) - 1
            raise InputError(
                f"{owner}: its rows over {variable} hold {matrix.data[at]} (row {row}, "
                f"{int(wrong.sum())} in all): check the data they are made of"
            )
    for name, values in sides.items():
        for variable, matrix in blocks.items():
            if matrix.shape[0] != len(values):
                raise InputError(
                    f"{owner}: {matrix.shape[0]} rows over {variable}, {name} has "
                    f"{len(values)} entries: give one for every row"
                )
        wrong = ~np.isfinite(values) if name == "target" else np.isnan(values)
        if wrong.any():
            row = int(np.flatnonzero(wrong)[0])
            raise InputError(
                f"{owner}: its {name} holds {values[row]} (row {row}, "
                f"{int(wrong.sum())} in all): leave those rows out"
            )

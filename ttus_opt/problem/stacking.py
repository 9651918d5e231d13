"""Rows of members over their own variables, placed over all variables of a program."""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.errors import InputError
from ttus_opt.problem.constraints.base import Bounds, ConeRows, LinearRows
from ttus_opt.problem.terms.base import AffineRows, Term

#: What a constraint declares
Held = LinearRows | ConeRows | Bounds


def variable_sizes(
    n_voxels: int, terms: Iterable[Term], held: Iterable[tuple[str, Held]]
) -> dict[str, int]:
    """Number of entries of every variable, the field p first.

    Args:
        n_voxels: V, the entries of p [–].
        terms: Terms of the objective.
        held: Names and rows of constraints.

    Raises:
        InputError: Two members give a variable different sizes.
    """
    sizes = {"p": n_voxels}
    members: list[tuple[str, AffineRows | Held]] = [
        *((term.name, term.assembled) for term in terms),
        *held,
    ]
    for owner, rows in members:
        if isinstance(rows, Bounds):
            given = {rows.variable: len(rows.lower)}
        else:
            given = {name: M.shape[1] for name, M in rows.blocks.items()}
        for name, size in given.items():
            if sizes.setdefault(name, size) != size:
                raise InputError(
                    f"{owner} gives variable {name!r} {size} entries, others "
                    f"{sizes[name]}"
                )
    return sizes


def stacked(
    blocks: Mapping[str, sp.csr_array], sizes: Mapping[str, int], n_rows: int
) -> sp.csr_array:
    """Blocks side by side in the order of the variables, zero where absent.

    Args:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        sizes: Entries of every variable, in their order.
        n_rows: m [–].

    Returns:
        Shape (m, n); with a single variable its block itself, not a copy.
    """
    if len(sizes) == 1:  # no copy in the usual case of p alone
        return blocks["p"]
    starts = np.concatenate([[0], np.cumsum(list(sizes.values()))])
    placed = dict(zip(sizes, starts, strict=False))
    some = [(placed[name], blocks[name]) for name in sizes if name in blocks]
    if not some:
        return sp.csr_array((n_rows, int(starts[-1])))
    # absent blocks move columns; to stack them too takes five times as long
    matrix = some[0][1] if len(some) == 1 else sp.hstack([b for _, b in some], "csr")
    widths = [block.shape[1] for _, block in some]
    before = np.concatenate([[0], np.cumsum(widths)[:-1]])
    index = sp.get_index_dtype(maxval=int(starts[-1]))
    moved = np.repeat(np.array([s for s, _ in some]) - before, widths).astype(index)
    columns = matrix.indices.astype(index)
    if moved.any():
        columns += moved[matrix.indices]
    parts = (matrix.data, columns, matrix.indptr.astype(index))
    return sp.csr_array(parts, shape=(n_rows, int(starts[-1])))

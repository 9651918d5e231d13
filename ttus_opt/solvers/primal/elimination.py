"""Schur complement of a sparse positive definite matrix on some of its unknowns.

Rows along one direction connect unknowns in chains. Chains are eliminated first, like
resistors in series: the only fill is between the two ends of a chain. The rest is
eliminated by a factorisation with the kept unknowns last, whose last block holds the
factors of the Schur complement.
"""

from __future__ import annotations

from typing import Literal

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.csgraph import reverse_cuthill_mckee
from scipy.sparse.linalg import SuperLU, splu

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.compiled import compiled

Order = Literal["MMD_AT_PLUS_A", "NATURAL"]
Indices = NDArray[np.int32] | IntArray

#: Most neighbours of an unknown inside a chain
NEIGHBOURS = 2


def eliminated(matrix: sp.csr_array, kept: Mask) -> sp.csc_array:
    """The Schur complement of a matrix on some of its unknowns, shape (k, k).

    Args:
        matrix: Symmetric positive definite, shape (n, n).
        kept: Which unknowns are kept, k of them, shape (n,).
    """
    coo = sp.coo_array(matrix)
    here, there, value = coo.row, coo.col, coo.data
    aside = (here != there) & (value != 0.0)
    ties = np.bincount(here[aside], minlength=len(kept))
    ends = kept | (ties > NEIGHBOURS)
    links = sp.csr_array(
        (value[aside], (here[aside], there[aside])), shape=matrix.shape
    )
    own = matrix.diagonal()
    change, between = _without_chains(links, own, ends)
    at = np.flatnonzero(ends)
    left = matrix[at][:, at] + between[at][:, at] + sp.diags_array(change[at])
    return _last_block(sp.csr_array(left), kept[at])


def _without_chains(
    links: sp.csr_array, own: Array, ends: Mask
) -> tuple[Array, sp.csr_array]:
    """Changes of the diagonal, (n,), and between ends, (n, n), by elimination."""
    at = np.flatnonzero(ends)
    room = np.count_nonzero(~ends[links[at].indices])
    change, found = np.zeros(len(own)), np.empty(room)
    pairs = np.empty((2, room), np.int64)
    csr = links.indptr, links.indices, links.data
    n = _eliminate_chains(csr, own, at, ends, change, pairs, found)
    here, there, value = *pairs[:, :n], found[:n]
    places = np.r_[here, there], np.r_[there, here]
    return change, sp.csr_array((np.r_[value, value], places), shape=links.shape)


@compiled(nogil=True)
def _eliminate_chains(
    csr: tuple[Indices, Indices, Array],
    own: Array,
    at: IntArray,
    ends: Mask,
    change: Array,
    pairs: IntArray,
    found: Array,
) -> int:
    """Walk every chain from one end to the other (compiled).

    Args:
        csr: Entries beside the diagonal: indptr, indices and data.
        own: The diagonal, shape (n,).
        at: Unknowns at which chains end.
        ends: Whether an unknown is one of them, shape (n,).
        change: Added to the diagonal, changed, shape (n,).
        pairs: Set to the two ends of every chain, shape (2, room).
        found: Set to the new entry between them, shape (room,).

    Returns:
        Number of pairs.
    """
    indptr, indices, data = csr
    walked = np.zeros(own.size, np.bool_)
    count = 0
    for start in at:
        for k in range(indptr[start], indptr[start + 1]):
            here, before, tie = indices[k], start, data[k]
            if ends[here] or walked[here]:
                continue
            pivot = own[here]
            while True:
                walked[here] = True
                following, link = -1, 0.0
                for j in range(indptr[here], indptr[here + 1]):
                    if indices[j] != before:
                        following, link = indices[j], data[j]
                change[start] -= tie * tie / pivot
                if following < 0:
                    break
                rest = -link / pivot
                if ends[following]:
                    change[following] += rest * link
                    if following == start:
                        change[start] += 2.0 * tie * rest
                    else:
                        pairs[0, count], pairs[1, count] = start, following
                        found[count] = tie * rest
                        count += 1
                    break
                pivot, tie = own[following] + rest * link, tie * rest
                before, here = here, following
    return count


def _last_block(matrix: sp.csr_array, kept: Mask) -> sp.csc_array:
    """The Schur complement by a factor, the kept unknowns last."""
    inner, last = np.flatnonzero(~kept), np.flatnonzero(kept)
    n = len(inner)
    if not n:
        return sp.csc_array(matrix)
    order = reverse_cuthill_mckee(
        sp.csr_matrix(matrix[inner][:, inner]), symmetric_mode=True
    )
    order = np.concatenate([inner[order], last])
    found = factor(sp.csc_array(matrix[order][:, order]), "NATURAL")
    places = np.sort(found.perm_r[n:])
    lower, upper = found.L[found.perm_r[n:]], found.U[:, found.perm_c[n:]]
    return sp.csc_array(lower[:, places] @ upper[places])


def factor(matrix: sp.csc_array, order: Order = "MMD_AT_PLUS_A") -> SuperLU:
    """A factor of a symmetric positive definite matrix, pivots on its diagonal."""
    return splu(
        matrix,
        permc_spec=order,
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )

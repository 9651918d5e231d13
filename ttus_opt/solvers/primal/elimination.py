"""A sparse positive definite matrix without its chains, and a factor.

Rows along one direction connect unknowns in chains. These are eliminated like resistors
in series: the only fill is between the two ends of a chain.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray
from scipy.sparse.linalg import SuperLU, splu

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.compiled import compiled

Indices = NDArray[np.int32] | IntArray

#: Most neighbours of an unknown inside a chain
NEIGHBOURS = 2


def without_chains(matrix: sp.csr_array, kept: Mask) -> tuple[sp.csc_array, Mask]:
    """The Schur complement of a matrix on all unknowns but chains.

    Args:
        matrix: Symmetric positive definite, shape (n, n).
        kept: Which unknowns belong to no chain, shape (n,).

    Returns:
        The complement, shape (k, k), and which unknowns it is on, shape (n,): those
        kept, and the joints of chains.
    """
    coo = sp.coo_array(matrix)
    here, there, value = coo.row, coo.col, coo.data
    aside = (here != there) & (value != 0.0)
    ties = np.bincount(here[aside], minlength=len(kept))
    ends = kept | (ties > NEIGHBOURS)
    links = sp.csr_array(
        (value[aside], (here[aside], there[aside])), shape=matrix.shape
    )
    at = np.flatnonzero(ends)
    room = np.count_nonzero(~ends[links[at].indices])
    change, found = np.zeros(len(kept)), np.empty(room)
    pairs = np.empty((2, room), np.int64)
    csr = links.indptr, links.indices, links.data
    n = _eliminate_chains(csr, matrix.diagonal(), at, ends, change, pairs, found)
    (one, other), value = pairs[:, :n], found[:n]
    places = np.r_[one, other], np.r_[other, one]
    between = sp.csr_array((np.r_[value, value], places), shape=matrix.shape)
    left = matrix[at][:, at] + between[at][:, at] + sp.diags_array(change[at])
    return sp.csc_array(left), ends


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


def factor(matrix: sp.csc_array) -> SuperLU:
    """A factor of a symmetric positive definite matrix, pivots on its diagonal."""
    return splu(
        matrix,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )

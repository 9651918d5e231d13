"""Compression of many measured rows over few voxels to few equivalent rows.

A recording at 1 kHz has tens of thousands of rows over some hundred voxels. With the QR
decomposition of rows and target together,

    [M t] = Q [R c; 0 ρ]   ⟹   ‖M x - t‖² = ‖R x - c‖² + ρ²,

R has no more rows than M has nonzero columns, and only the constant is lost. Blocks of
rows of one place, which touch few voxels each, are decomposed separately, and the
results again, while that pays. Only sums of squares are compressed; an answer is
verified with all rows.

See docs/method/solver.md, Dense recordings.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.problem.members import ProgramTerm, nonempty_columns
from ttus_opt.problem.program import Program

#: Fewest rows of a compressed term
LEAST_ROWS = 10_000

#: Fewest rows per nonzero column for the decomposition to pay
OVERDETERMINED = 4.0

#: Rows decomposed at once, and the least reduction of a round for another to follow
BLOCK, GAIN = 2048, 0.3


class Compression:
    """Compresses programs, keeping results while rows and targets stay the same.

    Attributes:
        rows: Numbers of rows before and after, of the compressed terms by name.
    """

    def __init__(self) -> None:
        self._kept: dict[str, tuple[ProgramTerm, ProgramTerm]] = {}
        self.rows: dict[str, tuple[int, int]] = {}

    def __call__(self, program: Program) -> Program:
        """The program with compressed terms; itself where none is compressed."""
        terms = tuple(self._compressed(term) for term in program.terms)
        pairs = list(zip(program.terms, terms, strict=True))
        self.rows = {
            old.name: (len(old.target), len(new.target))
            for old, new in pairs
            if new is not old
        }
        return replace(program, terms=terms) if self.rows else program

    def _compressed(self, term: ProgramTerm) -> ProgramTerm:
        if not _pays(term):
            return term
        kept = self._kept.get(term.name)
        if (
            kept is None
            or kept[0].matrix is not term.matrix
            or not np.array_equal(kept[0].target, term.target)
        ):
            matrix, target = compressed_rows(term.matrix, term.target)
            kept = term, replace(term, matrix=matrix, target=target)
            self._kept[term.name] = kept
        return kept[1].with_weight(term.weight)


def _pays(term: ProgramTerm) -> bool:
    """Whether a term is a sum of squares with many more rows than columns."""
    m = len(term.target)
    if m < LEAST_ROWS or not term.is_squares or term.laplace_rows is not None:
        return False
    return m >= OVERDETERMINED * len(nonempty_columns(term.matrix))


def compressed_rows(matrix: sp.csr_array, target: Array) -> tuple[sp.csr_array, Array]:
    """Rows R x - c with the squared norm of M x - t, up to a constant.

    Args:
        matrix: M, shape (m, n).
        target: t, shape (m,).

    Returns:
        R, shape (k, n), and c, shape (k,).

    >>> R, c = compressed_rows(sp.csr_array([[3.0], [4.0]]), np.array([1.0, 2.0]))
    >>> abs(R.toarray()).round(12), abs(c).round(12)
    (array([[5.]]), array([2.2]))
    """
    rows = sp.csr_array(matrix)
    order = _by_place(rows)
    rows, target = sp.csr_array(rows[order]), target[order]
    while True:
        with one_blas_thread():  # on a busy machine others take a hundred times longer
            parts = [
                _decomposed(rows[start : start + BLOCK], target[start : start + BLOCK])
                for start in range(0, rows.shape[0], BLOCK)
            ]
        before = rows.shape[0]
        rows = sp.csr_array(sp.vstack([part for part, _ in parts], format="csr"))
        target = np.concatenate([part for _, part in parts])
        if len(parts) == 1 or rows.shape[0] > (1.0 - GAIN) * before:
            return rows, target


def _by_place(rows: sp.csr_array) -> IntArray:
    """Order in which rows of nearly the same columns follow each other.

    Columns are numbered as a motion first comes to them, and rows sorted by the mean
    number of theirs: what it does at a place stands together, however often it returns.
    """
    first = np.zeros(rows.shape[1], dtype=np.int64)
    first[rows.indices[::-1]] = np.arange(rows.nnz)[::-1]
    rank = np.empty(len(first))
    columns = nonempty_columns(rows)
    rank[columns[np.argsort(first[columns])]] = np.arange(len(columns))
    n = np.diff(rows.indptr)
    total = np.bincount(np.repeat(np.arange(len(n)), n), rank[rows.indices], len(n))
    return np.argsort(total / np.maximum(n, 1), kind="stable")


def _decomposed(rows: sp.csr_array, target: Array) -> tuple[sp.csr_array, Array]:
    """R and c of a block of rows; the block itself where R would be no smaller."""
    m, n = rows.shape
    columns = nonempty_columns(rows)
    k = len(columns)
    if k >= m:
        return rows, target
    both = np.empty((m, k + 1), order="F")
    both[:, :k] = rows[:, columns].toarray()
    both[:, k] = target
    (R,) = la.qr(both, mode="r", overwrite_a=True, check_finite=False)
    upper = sp.coo_array(np.triu(R[:k, :k]))
    places = upper.row, columns[upper.col]
    spread = sp.csr_array((upper.data, places), shape=(k, n))
    return spread, np.ascontiguousarray(R[:k, k])

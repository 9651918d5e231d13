"""What terms and constraints are: members with a scene, a name and rows.

Declared rows are validated, and placed in a program: sparse matrices of any format
become ``csr_array`` of floats, lists of numbers arrays.
"""

from __future__ import annotations

import abc
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any, TypeVar

import numpy as np
import scipy.sparse as sp

from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.structure import Tags

_Member = TypeVar("_Member")


@dataclass(frozen=True, eq=False)
class AffineRows:
    """Named rows r = Σ_k M_k x_k - t over the variables x_k they touch.

    Attributes:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        target: t, shape (m,).
        tags: Structure that solvers may use, see `ttus_opt.problem.terms.structure`.
    """

    blocks: Mapping[str, sp.csr_array]
    target: Array
    tags: Tags = frozenset()


@dataclass(frozen=True, eq=False)
class LinearRows:
    """Rows lower ≤ Σ_k M_k x_k ≤ upper.

    Attributes:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        lower: Lower limits, -inf where there is none, shape (m,).
        upper: Upper limits, +inf where there is none, shape (m,).
        tags: Structure that solvers may use, see `ttus_opt.problem.terms.structure`.
    """

    blocks: Mapping[str, sp.csr_array]
    lower: Array
    upper: Array
    tags: Tags = frozenset()


@dataclass(frozen=True, eq=False)
class ConeRows:
    """Rows s = Σ_k M_k x_k + h in second-order cones, s₀ ≥ ‖(s₁, …)‖ each.

    Attributes:
        blocks: Matrix per variable, each of shape (m, size of the variable).
        offset: h, shape (m,).
        sizes: Rows of each cone, one cone after the other, m in all.
    """

    blocks: Mapping[str, sp.csr_array]
    offset: Array
    sizes: tuple[int, ...]


@dataclass(frozen=True, eq=False)
class Bounds:
    """Bounds lower ≤ x_k ≤ upper on one whole variable.

    Attributes:
        variable: Its name.
        lower: Shape of the variable, -inf where there is none.
        upper: Shape of the variable, +inf where there is none.
    """

    variable: str
    lower: Array
    upper: Array


@dataclass(frozen=True)
class Member(abc.ABC):
    """A member of a formulation.

    Attributes:
        scene: The scene from which its rows are made.
    """

    scene: Scene = field(repr=False)

    @property
    def name(self) -> str:
        """Its name, and that of its cost, slack or dual.

        Raises:
            InputError: The class has no name.
        """
        kind = type(self).__name__
        raise InputError(f'{kind} has no name: add name = "…" to the class')

    @abc.abstractmethod
    def rows(self) -> object:
        """Its rows over the variables."""


def replaced(member: _Member, *cached: str, **changes: Any) -> _Member:
    """`dataclasses.replace` that keeps cached properties.

    Args:
        member: A frozen dataclass.
        cached: Names of cached properties that the changes do not affect; others are
            recomputed.
        changes: New values of fields.
    """
    other: _Member = replace(member, **changes)  # type: ignore[type-var]
    known = vars(member)
    vars(other).update({name: known[name] for name in cached if name in known})
    return other


Blocks = dict[str, sp.csr_array]


def unit_rows(columns: IntArray, n: int) -> sp.csr_array:
    """Rows of the identity, one per given column, shape (k, n).

    >>> unit_rows(np.array([2, 0]), 3).toarray()
    array([[0., 0., 1.],
           [1., 0., 0.]])
    """
    k = len(columns)
    return sp.csr_array((np.ones(k), columns, np.arange(k + 1)), shape=(k, n))


def uniform_blocks(owner: str, blocks: Any, n_rows: int) -> Blocks:
    """Matrices by variable as ``csr_array`` of floats.

    Args:
        owner: The member that declares them, for messages.
        blocks: The declared matrices.
        n_rows: Number of rows of each.

    Raises:
        InputError: Not sparse real matrices of this number of rows, or not finite.
    """
    if not (isinstance(blocks, Mapping) and blocks):
        raise InputError(
            f"{owner}: blocks must be sparse matrices by variable, such as "
            f'{{"p": M}}, got {_described(blocks)}'
        )
    return {name: _matrix(owner, name, M, n_rows) for name, M in blocks.items()}


def _matrix(owner: str, variable: str, matrix: Any, n_rows: int) -> sp.csr_array:
    what = f"{owner}: its matrix over {variable}"
    if not sp.issparse(matrix):
        raise InputError(
            f"{what} must be sparse, got {_described(matrix)}: wrap it in "
            "scipy.sparse.csr_array"
        )
    given: Any = matrix
    if given.dtype.kind not in "fiub" or given.ndim != 2:
        raise InputError(f"{what} must be real and 2-D, got {_described(given)}")
    if not (isinstance(given, sp.csr_array) and given.dtype == np.float64):
        given = sp.csr_array(given.astype(np.float64))
    rows: sp.csr_array = given
    if rows.shape[0] != n_rows:
        raise InputError(
            f"{owner}: {rows.shape[0]} rows over {variable}, but {n_rows} entries in "
            "its vector: give one entry per row"
        )
    wrong = ~np.isfinite(rows.data)
    if wrong.any():
        at = int(np.flatnonzero(wrong)[0])
        row = int(np.searchsorted(rows.indptr, at, side="right")) - 1
        raise InputError(
            f"{owner}: its rows over {variable} hold {rows.data[at]} (row {row}, "
            f"{int(wrong.sum())} in all): check the data they are made from"
        )
    return rows


def uniform_vector(owner: str, name: str, values: Any, *, finite: bool) -> Array:
    """A vector of floats with one entry per row.

    Args:
        owner: The member that declares it, for messages.
        name: Its name in messages: target, lower limit, upper limit.
        values: The declared values.
        finite: Whether infinite entries are refused; NaN always is.

    Raises:
        InputError: Not a vector of real numbers, or refused entries.
    """
    try:
        vector = np.asarray(values)
    except ValueError:  # a ragged list
        vector = np.asarray(None)
    if vector.ndim != 1 or vector.dtype.kind not in "fiub":
        raise InputError(
            f"{owner}: its {name} must be a vector of real numbers, one per row, got "
            f"{_described(values)}"
        )
    if vector.dtype != np.float64:
        vector = vector.astype(np.float64)
    wrong = ~np.isfinite(vector) if finite else np.isnan(vector)
    if wrong.any():
        row = int(np.flatnonzero(wrong)[0])
        raise InputError(
            f"{owner}: its {name} holds {vector[row]} (row {row}, "
            f"{int(wrong.sum())} in all): leave those rows out"
        )
    return vector


def _described(value: Any) -> str:
    """A short description of a value."""
    if hasattr(value, "dtype"):
        sort = "a sparse matrix" if sp.issparse(value) else "an array"
        return f"{sort} of {value.dtype} of shape {value.shape}"
    return "None" if value is None else f"a {type(value).__name__}"


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

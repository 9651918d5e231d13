"""The weights of a path: an axis per term, or per group of terms with one weight."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError

#: Weights of every axis, by the name of a term or the names of several
Weights = Mapping[str | tuple[str, ...], ArrayLike]

#: Most points of a grid
MOST = 100_000

Index = tuple[int, ...]


@dataclass(frozen=True)
class WeightAxis:
    """Weights of one or more terms.

    Attributes:
        terms: Names of the terms.
        values: Ascending, positive, shape (n,) [–].
    """

    terms: tuple[str, ...]
    values: Array

    @property
    def dimension(self) -> str:
        """Name of the axis in a dataset."""
        return f"{self.terms[0]}_weight"


@dataclass(frozen=True)
class WeightGrid:
    """All combinations of the weights of several axes.

    Attributes:
        axes: One or more axes.
    """

    axes: tuple[WeightAxis, ...]

    @classmethod
    def of(cls, weights: Weights, known: Sequence[str]) -> WeightGrid:
        """Read weights as a user gives them.

        Args:
            weights: Values by term; a tuple of names for terms with a common weight.
            known: Names of all terms.

        Raises:
            InputError: Nothing to vary, an unknown term or one named twice, or weights
                that are not positive, finite and different.
        """
        if not (isinstance(weights, Mapping) and weights):
            raise InputError(
                'weights takes values by term, such as {"force": [1e-4, 1e-2, 1]}, got '
                f"{weights!r}"
            )
        axes = [
            WeightAxis(terms, _values(terms, given))
            for terms, given in ((_terms(key), v) for key, v in weights.items())
        ]
        named = [name for axis in axes for name in axis.terms]
        for name in named:
            if name not in known:
                raise InputError(f"no term {name!r}, there are {', '.join(known)}")
            if named.count(name) > 1:
                raise InputError(f"term {name!r} has two lists of weights: give one")
        grid = cls(tuple(axes))
        if grid.size > MOST:
            raise InputError(f"{grid.size:,} points of weights: give at most {MOST:,}")
        return grid

    @property
    def shape(self) -> Index:
        """Weights per axis [–]."""
        return tuple(len(axis.values) for axis in self.axes)

    @property
    def size(self) -> int:
        """Number of points [–]."""
        return int(np.prod([float(n) for n in self.shape]))

    def at(self, index: Index) -> dict[str, float]:
        """The weights of one point, by term."""
        return {
            name: float(axis.values[i])
            for axis, i in zip(self.axes, index, strict=True)
            for name in axis.terms
        }

    def from_both_ends(self) -> list[Index]:
        """All points, the ends of each axis first, then halves, quarters and so on.

        Points between solved ones need few new response fields.
        """
        ranks = [{i: r for r, i in enumerate(_halving(n))} for n in self.shape]

        def late(index: Index) -> tuple[int, int]:
            places = [rank[i] for rank, i in zip(ranks, index, strict=True)]
            return max(places), sum(places)

        return sorted(itertools.product(*map(range, self.shape)), key=late)

    def from_the_prior(self) -> list[Index]:
        """All points from the smallest weights on, each a neighbour of the last."""
        return list(_winding(self.shape))


def _terms(key: str | tuple[str, ...]) -> tuple[str, ...]:
    names = (key,) if isinstance(key, str) else key
    if not (
        isinstance(names, tuple) and names and all(isinstance(n, str) for n in names)
    ):
        raise InputError(
            f"weights are named by a term or a tuple of terms, got {key!r}"
        )
    return names


def _values(terms: tuple[str, ...], given: ArrayLike) -> Array:
    whose = f"the weights of {' and '.join(terms)}"
    try:
        values = np.atleast_1d(np.asarray(given, dtype=np.float64))
    except (TypeError, ValueError):
        raise InputError(f"{whose} must be numbers, got {given!r}") from None
    if values.ndim != 1 or not len(values):
        raise InputError(
            f"{whose} must be one or more positive numbers in a row, got an array of "
            f"shape {values.shape}"
        )
    wrong = values[~(np.isfinite(values) & (values > 0.0))]
    if len(wrong):
        raise InputError(
            f"{whose} must be positive numbers, got {_listed(wrong)}: a path is over "
            "their logarithm"
        )
    ascending, counts = np.unique(values, return_counts=True)
    if len(ascending) < len(values):
        twice = _listed(ascending[counts > 1])
        raise InputError(f"{whose} must differ from each other, got {twice} repeatedly")
    return ascending


def _listed(values: Array, most: int = 5) -> str:
    """The first few numbers as text."""
    more = ", …" if len(values) > most else ""
    return ", ".join(f"{value:g}" for value in values[:most]) + more


def _halving(n: int) -> Iterator[int]:
    """Numbers below n: the last, the first, then midpoints of the gaps.

    >>> list(_halving(5))
    [4, 0, 2, 3, 1]
    """
    yield n - 1
    if n > 1:
        yield 0
    gaps = [(0, n - 1)]
    for low, high in gaps:  # grows during the loop
        if high - low > 1:
            middle = (low + high) // 2
            yield middle
            gaps += [(middle, high), (low, middle)]


def _winding(shape: Index) -> Iterator[Index]:
    """Every index of a grid, consecutive ones being neighbours.

    >>> list(_winding((2, 2)))
    [(0, 0), (0, 1), (1, 1), (1, 0)]
    """
    if not shape:
        yield ()
        return
    rest = list(_winding(shape[1:]))
    for i in range(shape[0]):
        for index in rest if i % 2 == 0 else rest[::-1]:
            yield (i, *index)

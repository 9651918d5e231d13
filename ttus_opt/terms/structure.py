"""Structure that terms and constraints declare of their rows, for solvers to read.

A solver that can use more than the numbers of a matrix looks for these tags; it never
recognises a matrix by its entries or a member by its name. What a tag says is compared
with the rows once, when they are assembled, so that a solver may rely on it. The idea
is that of lineax (Rader, Lyons, Kidger, 2023).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np
import scipy.sparse as sp

from ttus_opt.arrays import Array, IntArray
from ttus_opt.errors import InputError
from ttus_opt.laplace.system import LaplaceSystem

#: Relative difference of two products that is rounding
ROUNDING = 1e-12

#: Difference of R C Rᵀ and the identity that is rounding: R's condition squared [–]
COVARIANCE_ROUNDING = 1e-6


class Tag(enum.Enum):
    """What rows are, where one word says it."""

    MEASURED = "rows are measurements, whose noise their residuals show"
    DIRICHLET = "row k gives the k-th Dirichlet voxel of p its value"


@dataclass(frozen=True, eq=False)
class LaplaceRows:
    """Rows over one voxel field are those of the scene's L; they touch no other field.

    Attributes:
        variable: The field's name.
        scale: None where the rows are those of L as they are; otherwise they are L's
            rows in order, all or the free ones, each times its voxel's positive
            number, shape (V,) [–].
        beside: Names of parameters, a few numbers each, that have columns there too.
        system: A variant of L on the scene's voxmap; None for the scene's L.
    """

    variable: str = "p"
    scale: Array | None = field(default=None, repr=False)
    beside: tuple[str, ...] = ()
    system: LaplaceSystem | None = field(default=None, repr=False)


class FieldCovariance(Protocol):
    """A covariance over the voxels, known where it is asked for."""

    def columns(self, voxels: IntArray) -> CovarianceColumns:
        """Its columns at some voxels."""

    def times(self, values: Array) -> Array:
        """Covariance @ values, shape (V,)."""

    def among_rows(self, rows: sp.csr_array, height: int) -> Array:
        """Covariance of blocks of rows of a field, (k, height, height)."""

    def draw(self, rng: np.random.Generator) -> Array:
        """A field of this covariance and mean zero, shape (V,)."""


class CovarianceColumns(Protocol):
    """Some columns of a covariance, without their V entries each."""

    @property
    def voxels(self) -> IntArray:
        """Which ones, shape (n,)."""

    @property
    def among(self) -> Array:
        """The covariance between these voxels, shape (n, n)."""

    def times(self, values: Array) -> Array:
        """Columns @ values: (n,) to (V,)."""

    def of_rows(self, rows: sp.csr_array) -> Array:
        """Few rows of a field @ columns, shape (k, n)."""


@dataclass(frozen=True, eq=False)
class KnownCovariance:
    """Square rows R over p alone whose covariance (RᵀR)⁻¹ is known.

    Attributes:
        covariance: It.
    """

    covariance: FieldCovariance = field(repr=False)


Tags = frozenset[Tag | LaplaceRows | KnownCovariance]


def laplace_rows(tags: Tags) -> LaplaceRows | None:
    """The declaration of L's rows among tags, if there is one."""
    return next((tag for tag in tags if isinstance(tag, LaplaceRows)), None)


def known_covariance(tags: Tags) -> KnownCovariance | None:
    """The declaration of a known covariance among tags, if there is one."""
    return next((tag for tag in tags if isinstance(tag, KnownCovariance)), None)


def check_structure(
    owner: str,
    tags: Tags,
    blocks: Mapping[str, sp.csr_array],
    laplace: LaplaceSystem,
) -> None:
    """Compare declared structure with the rows.

    Args:
        owner: What declares them, for the message.
        tags: The declaration.
        blocks: Matrix per variable.
        laplace: The scene's L.

    Raises:
        InputError: The rows are not what they are declared to be.
    """
    declared = laplace_rows(tags)
    if declared is not None and not _are_laplace(declared, blocks, laplace):
        raise InputError(
            f"{owner}: it declares the rows of the scene's L over "
            f"{declared.variable!r}, but its rows differ: drop the tag LaplaceRows"
        )
    known = known_covariance(tags)
    if known is not None and not _has_covariance(known, blocks, laplace):
        raise InputError(
            f"{owner}: the covariance it declares is not that of its rows: drop the "
            "tag KnownCovariance"
        )
    if Tag.DIRICHLET in tags and not _are_dirichlet(blocks, laplace):
        raise InputError(
            f"{owner}: it declares a row for each Dirichlet voxel of p, but its rows "
            "differ: drop the tag DIRICHLET"
        )


def _are_laplace(
    declared: LaplaceRows, blocks: Mapping[str, sp.csr_array], laplace: LaplaceSystem
) -> bool:
    """Whether rows have L's size and do to a random field what L does."""
    V = len(laplace.free)
    beside = [blocks[name].shape[1] for name in declared.beside if name in blocks]
    if {declared.variable, *declared.beside} != set(blocks) or V in beside:
        return False
    system = declared.system or laplace
    if system.voxmap is not laplace.voxmap:
        return False
    own, L, scale = blocks[declared.variable], system.L, declared.scale
    if own is L and scale is None:
        return True
    if scale is not None and not (scale.shape == (V,) and (scale > 0.0).all()):
        return False
    n_rows = own.shape[0]
    whole = n_rows == V
    only_free = scale is not None and n_rows == int(laplace.free.sum())
    if own.shape[1] != V or not (whole or only_free):
        return False
    probe = np.random.default_rng(0).normal(size=V)
    expected = L @ probe
    if scale is not None:
        expected = scale * expected
        expected = expected if whole else expected[laplace.free]
    size = float(np.abs(expected).max(initial=0.0))
    return bool(np.abs(own @ probe - expected).max(initial=0.0) <= ROUNDING * size)


def _has_covariance(
    known: KnownCovariance, blocks: Mapping[str, sp.csr_array], laplace: LaplaceSystem
) -> bool:
    """Whether R C Rᵀ leaves a random vector as it is."""
    V = len(laplace.free)
    if set(blocks) != {"p"} or blocks["p"].shape != (V, V):
        return False
    probe = np.random.default_rng(0).normal(size=V)
    again = blocks["p"] @ known.covariance.times(blocks["p"].T @ probe)
    return bool(np.abs(again - probe).max() <= COVARIANCE_ROUNDING)


def _are_dirichlet(blocks: Mapping[str, sp.csr_array], laplace: LaplaceSystem) -> bool:
    fixed = np.flatnonzero(~laplace.free)
    if set(blocks) != {"p"}:
        return False
    own = blocks["p"]
    return bool(
        own.shape == (len(fixed), len(laplace.free))
        and np.array_equal(own.indptr, np.arange(len(fixed) + 1))
        and np.array_equal(own.indices, fixed)
        and (own.data == 1.0).all()
    )

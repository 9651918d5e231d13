"""Structure that terms and constraints declare for their rows, for use by solvers.

Solvers read these tags; they never recognise a matrix by its entries or a member by its
name. Tags are checked against the rows once, when these are assembled, so that solvers
may rely on them. The idea is that of lineax (Rader, Lyons, Kidger, 2023).
"""

from __future__ import annotations

import enum
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.gaussian.matern import SeparableCovariance
from ttus_opt.laplace.system import LaplaceSystem

#: Relative difference of two products up to rounding
ROUNDING = 1e-12

#: Largest difference of R C Rᵀ from the identity by rounding, which grows with the
#: square of R's condition number [–]
COVARIANCE_ROUNDING = 1e-6


class Tag(enum.Enum):
    """Structure without parameters."""

    MEASURED = "rows are measurements"
    DIRICHLET = "row k gives the k-th Dirichlet voxel of p its value"
    OWN_MEAN = "target is that of the term's own mean, not of the boundary values"


@dataclass(frozen=True, eq=False)
class LaplaceRows:
    """Rows of the scene's L over one voxel field, and over no other field.

    Attributes:
        variable: The field's name.
        scale: Positive factors of the rows by voxel, shape (V,) [–]; the rows are all
            those of L, or the free ones, in order. None for L itself.
        beside: Names of parameters, a few numbers each, with columns in these rows.
        system: A variant of L on the scene's voxmap; None for the scene's L.
    """

    variable: str = "p"
    scale: Array | None = field(default=None, repr=False)
    beside: tuple[str, ...] = ()
    system: LaplaceSystem | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class KnownCovariance:
    """Square rows R over p alone whose covariance (RᵀR)⁻¹ is known.

    Attributes:
        covariance: (RᵀR)⁻¹.
        mean: What is uncertain about the mean of the prior; None for nothing.
    """

    covariance: SeparableCovariance = field(repr=False)
    mean: UncertainMean | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class UncertainMean:
    """A mean μ that the measurements themselves gave, and the deviation from it.

    Attributes:
        drift: Columns h_j, of which the true mean is μ + Σ β_j h_j with β ~ N(0, 1),
            shape (V, k).
        size_slopes: Relative change of every measured wrench per ln ℓ₀ of
            `contact-size`, shape (T,) [–].
        size_deviation: Prior standard deviation of ln ℓ₀ [–].
        deviation: Relative standard deviation of the field about its mean [–].
        usual: What it is in bodies in general, and the standard deviation of its
            logarithm [–].
        length: Length over which it varies along the surface [m].
        shared_error: Median and logarithmic standard deviation of the prior of the
            relative error that frames of a place share [–].
    """

    drift: Array = field(repr=False)
    size_slopes: Array = field(repr=False)
    size_deviation: float
    deviation: float
    usual: tuple[float, float]
    length: float
    shared_error: tuple[float, float]


@dataclass(frozen=True, eq=False)
class Whitened:
    """Rows of measured wrenches, three per frame, multiplied by a regular matrix.

    Without this tag they are the wrenches themselves [N, N·m].

    Attributes:
        by: The matrix, shape (3T, 3T) [1/N or 1/N·m, up to a factor].
    """

    by: sp.csr_array = field(repr=False)


Tags = frozenset[Tag | LaplaceRows | KnownCovariance | Whitened]

Declared = TypeVar("Declared", LaplaceRows, KnownCovariance, Whitened)


def declared(tags: Tags, kind: type[Declared]) -> Declared | None:
    """The declaration of a kind among tags, if there is one."""
    return next((tag for tag in tags if isinstance(tag, kind)), None)


def check_structure(
    owner: str,
    tags: Tags,
    blocks: Mapping[str, sp.csr_array],
    laplace: LaplaceSystem,
) -> None:
    """Compare declared structure with the rows.

    Args:
        owner: The member that declares them, for messages.
        tags: The declaration.
        blocks: Matrix per variable.
        laplace: The scene's L.

    Raises:
        InputError: A tag does not match the rows.
    """
    rows = declared(tags, LaplaceRows)
    if rows is not None and not _are_laplace(rows, blocks, laplace):
        raise InputError(
            f"{owner}: it declares the rows of the scene's L over "
            f"{rows.variable!r}, but its rows differ: drop the tag LaplaceRows"
        )
    known = declared(tags, KnownCovariance)
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
    rows: LaplaceRows, blocks: Mapping[str, sp.csr_array], laplace: LaplaceSystem
) -> bool:
    """Whether rows have L's size and the same product with a random field."""
    V = len(laplace.free)
    beside = [blocks[name].shape[1] for name in rows.beside if name in blocks]
    if {rows.variable, *rows.beside} != set(blocks) or V in beside:
        return False
    system = rows.system or laplace
    if system.voxmap is not laplace.voxmap:
        return False
    block, L, scale = blocks[rows.variable], system.L, rows.scale
    if block is L and scale is None:
        return True
    if scale is not None and not (scale.shape == (V,) and (scale > 0.0).all()):
        return False
    n_rows = block.shape[0]
    whole = n_rows == V
    only_free = scale is not None and n_rows == int(laplace.free.sum())
    if block.shape[1] != V or not (whole or only_free):
        return False
    probe = np.random.default_rng(0).normal(size=V)
    expected = L @ probe
    if scale is not None:
        expected = scale * expected
        expected = expected if whole else expected[laplace.free]
    size = float(np.abs(expected).max(initial=0.0))
    return bool(np.abs(block @ probe - expected).max(initial=0.0) <= ROUNDING * size)


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
    block = blocks["p"]
    return bool(
        block.shape == (len(fixed), len(laplace.free))
        and np.array_equal(block.indptr, np.arange(len(fixed) + 1))
        and np.array_equal(block.indices, fixed)
        and (block.data == 1.0).all()
    )

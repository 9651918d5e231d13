"""Rows that must hold: linear rows between limits, second-order cones, bounds."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import scipy.sparse as sp

from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.structure import Tags


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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


@dataclass(frozen=True)
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

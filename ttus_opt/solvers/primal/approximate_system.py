"""The dual system with approximate solves: P⁻¹ = L̃⁻¹ Ω L̃⁻ᵀ, one V-cycle for each L̃⁻¹.

Where wide terms have rows at soft Dirichlet voxels, Ω is not diagonal there. Such rows
also touch free voxels: Ω is the block at the soft voxels of the inverse of Ω⁻¹ and
these rows over both. Dirichlet voxels lie in layers on the rim and on the surface, so
that this can be factorised.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.laplace.multigrid import OneCycle
from ttus_opt.laplace.system import RTOL, BlockSystem, LaplaceSystem
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.solvers.dual.system import DualSystem
from ttus_opt.solvers.primal.elimination import factor, without_chains
from ttus_opt.solvers.primal.matching import matched_root
from ttus_opt.solvers.primal.unseen_fields import UnseenFields, joined

#: Rows at Dirichlet voxels are left out where their squares over Ω⁻¹ stay below [–]
LIGHT = 0.3

#: Largest connected set of voxels that is eliminated as a whole
FEW_JOINED = 1000


@dataclass(frozen=True)
class FixedBlock:
    """Ω at fixed voxels, where it is not diagonal.

    Attributes:
        at: The voxels, shape (k,).
        solve: Ω times a vector of theirs, shape (k,).
    """

    at: IntArray = field(repr=False)
    solve: Callable[[Array], Array] = field(repr=False)

    @classmethod
    def of(
        cls, wide: Sequence[ProgramTerm], free: Mask, compliance: Array
    ) -> FixedBlock | None:
        """Factorise it; None where the diagonal suffices.

        Args:
            wide: The wide terms.
            free: Voxels with a Laplace row, shape (V,).
            compliance: Ω of the Laplace term, shape (V,) [–].
        """
        soft = ~free & (compliance > 0.0)
        at = np.flatnonzero(soft)
        rows = []
        for term in wide:
            M = term.matrix
            rows.append(np.sqrt(term.weight) * M[_beside(M, soft)])
        own = sp.csr_array(sp.vstack([sp.csr_array((0, len(free))), *rows]))
        heavy = np.bincount(own.indices, own.data**2, len(free)) * compliance
        if not heavy[at].max(initial=0.0) > LIGHT:
            return None
        reached = soft.copy()
        reached[own.indices] = True
        both = np.flatnonzero(reached)
        own = sp.csr_array(own[:, both])
        stiffness = np.where(soft, 1.0 / np.where(soft, compliance, 1.0), 1.0)[both]
        whole = sp.csr_array(own.T @ own + sp.diags_array(stiffness))
        left, ends = without_chains(whole, soft[both])
        kept, factors = soft[both][ends], factor(left)

        def solve(values: Array) -> Array:
            side = np.zeros(len(kept))
            side[kept] = values
            return np.asarray(factors.solve(side)[kept])

        return cls(at, solve)


def _beside(M: sp.csr_array, soft: Mask) -> IntArray:
    """Rows that touch soft voxels, or are connected to them through small sets.

    Where rows connect only few voxels, as rows along one direction do, all rows of a
    connected set are returned.
    """
    sets = joined([M])
    small = np.bincount(sets).max() <= FEW_JOINED
    reached = np.isin(sets, np.unique(sets[soft])) if small else soft
    return np.flatnonzero(sp.csr_array(abs(M)) @ reached.astype(float) > 0.0)


@dataclass(frozen=True)
class ApproximateSystem(DualSystem):
    """A dual system whose L has approximate solves.

    Attributes:
        fixed: Ω at Dirichlet voxels where it is not diagonal; None where it is.
        unseen: Deflated fields; None for none.
    """

    fixed: FixedBlock | None = None
    unseen: UnseenFields | None = None

    @classmethod
    def matched(
        cls,
        exact: DualSystem,
        wide: Sequence[ProgramTerm],
        unseen: UnseenFields | None = None,
    ) -> ApproximateSystem:
        """That of a whole field over wide terms, by the multigrid of L - X.

        Args:
            exact: The dual system.
            wide: The wide terms.
            unseen: As above.
        """
        laplace = exact.laplace
        assert isinstance(laplace, LaplaceSystem)
        root = matched_root(wide, laplace, exact.compliance, unseen is not None)
        grid = laplace.operator_grid
        cycle = OneCycle(grid, grid.unflatten(laplace.free), added=root.added)
        block = BlockSystem(laplace.free, laplace.radii, laplace.coupling, cycle)
        near = replace(exact, laplace=block)
        return cls.of(near, root.coupling, wide, unseen)

    @classmethod
    def of(
        cls,
        near: DualSystem,
        more: sp.csr_array,
        wide: Sequence[ProgramTerm],
        unseen: UnseenFields | None = None,
    ) -> ApproximateSystem:
        """That of a system with one V-cycle of L - X for A.

        Args:
            near: The system.
            more: Added to L's entries in free rows and fixed columns, (V, V).
            wide: The wide terms.
            unseen: As above.
        """
        square = near.laplace
        if more.nnz:
            inward = sp.csr_array(square.coupling[0] + more)
            coupling = inward, sp.csr_array(inward.T)
            square = BlockSystem(square.free, square.radii, coupling, square.multigrid)
        fixed = FixedBlock.of(wide, square.free, near.compliance)
        rows = near.rows, near.root_weights, near.n_measured
        return cls(square, near.compliance, *rows, fixed, unseen)

    def prior(self, r: Array, rtol: float = RTOL) -> Array:
        """P⁻¹r by one V-cycle each way, shape (V,)."""
        if self.unseen is not None:
            return self.unseen.beside(self._of_laplace, r)
        return self._of_laplace(r)

    def _of_laplace(self, r: Array) -> Array:
        slope = self.laplace.solve_adjoint(r)
        middle = self.compliance * slope
        if self.fixed is not None:
            middle[self.fixed.at] = self.fixed.solve(slope[self.fixed.at])
        return self.laplace.solve(middle)

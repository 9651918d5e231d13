"""Preconditioner of the dual: an approximate Schur complement by V-cycles.

The relative error of a V-cycle B ≈ A⁻¹ is bounded, so S̃ = I + D B ω B Dᵀ is spectrally
equivalent to the Schur complement S. Conjugate gradients on S̃ z = r, stopped early,
precondition S y = t at any weight, in a number of steps that hardly grows. They take
many steps, but only within a box of the grid around the contact
(`laplace.multigrid.subdomain`): on a million voxels hundreds cost as much as one exact
product. Rows of a subproblem outside that box matter little and are treated as the
identity. The S of a coarser grid is not equivalent: its error is small only compared
with the largest eigenvalues of S.
"""

from __future__ import annotations

import copy
from functools import cached_property

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, Mask
from ttus_opt.problem.members import nonempty_columns
from ttus_opt.solvers.conjugate_gradients import (
    RecycledSubspace,
    conjugate_gradients,
    norm,
)
from ttus_opt.solvers.dual import options
from ttus_opt.solvers.dual.system import DualSystem


class ApproximateSchur:
    """y ↦ S̃ y, in single precision and in a box around the contact.

    Attributes:
        root_weights: As in `DualSystem`, shape (m,) [–].
        fixed: Fixed voxels with soft values in the box, shape (k,).
    """

    def __init__(self, system: DualSystem) -> None:
        """Gather the parts of the system that a product uses.

        Args:
            system: The exact dual system.
        """
        laplace, compliance = system.laplace, system.compliance
        inward, outward = laplace.coupling
        touched = nonempty_columns(system.rows)
        contact = nonempty_columns(system.rows[: system.n_measured])
        self.root_weights = system.root_weights
        self._cycle = laplace.multigrid.preconditioner(
            near=contact[laplace.free[contact]]
        )
        free = self._cycle.free
        own = touched[free[touched]]
        rim = np.flatnonzero((np.diff(inward.indptr) > 0) & free)
        fixed = np.union1d(inward[rim].indices, touched[~laplace.free[touched]])
        self.fixed = fixed = fixed[compliance[fixed] > 0.0]
        self._own, self._rim = self._cycle.places(own), self._cycle.places(rim)
        self._rows = system.rows[:, np.concatenate([own, fixed])].astype(np.float32)
        self._adjoint = sp.csr_array(self._rows.T)
        radii = sp.diags_array(laplace.radii[rim])
        self._inward = sp.csr_array(radii @ inward[rim][:, fixed]).astype(np.float32)
        self._outward = sp.csr_array(outward[fixed][:, rim] @ radii).astype(np.float32)
        self._compliance_fixed = compliance[fixed].astype(np.float32)
        every = np.flatnonzero(free)
        self._middle = np.zeros_like(self._cycle.b)
        middle = compliance * laplace.radii**2
        self._middle[self._cycle.places(every)] = middle[every]

    def apply(self, y: Array, rtol: float = 0.0) -> Array:
        """S̃ y.

        Args:
            y: Shape (m,).
            rtol: Ignored: the accuracy of a V-cycle is fixed.

        Returns:
            Shape (m,).
        """
        p_fixed = self.slope(y) * self._compliance_fixed
        # L: A p = R ω R x + flow from fixed voxels
        np.multiply(self._middle, self._cycle.x, out=self._cycle.b)
        return np.asarray(y + self._measured(p_fixed))

    def slope(self, y: Array) -> Array:
        """L⁻ᵀDᵀ y at the fixed voxels, shape (k,)."""
        cycle, count = self._cycle, len(self._own)
        load = self._adjoint @ (self.root_weights * y).astype(np.float32)
        # Lᵀ: A x = load, then q = -R x on free voxels, and the flow to fixed ones
        cycle.b.fill(0.0)
        cycle.b[self._own] = load[:count]
        cycle.run_adjoint()
        return np.asarray(load[count:] + self._outward @ cycle.x[self._rim])

    def measured(self, p_fixed: Array) -> Array:
        """D L⁻¹ of values at the fixed voxels, (k,), and zeros elsewhere: (m,)."""
        self._cycle.b.fill(0.0)
        return self._measured(p_fixed.astype(np.float32))

    def _measured(self, p_fixed: Array) -> Array:
        """Like `measured`, with the values in ``b`` at the free voxels."""
        cycle = self._cycle
        cycle.b[self._rim] += self._inward @ p_fixed
        cycle.run()
        own = np.concatenate([cycle.x[self._own], p_fixed])
        return np.asarray(self.root_weights * (self._rows @ own))

    def without(self, held: Mask) -> ApproximateSchur:
        """S̃ if some of the fixed voxels have given values.

        Args:
            held: Which of them, shape (k,).
        """
        other = copy.copy(self)
        own = np.where(held, 0.0, self._compliance_fixed)
        other._compliance_fixed = own.astype(np.float32)
        return other


class SchurPreconditioner:
    """Approximation of S̃⁻¹ by conjugate directions, kept from call to call."""

    def __init__(self, system: DualSystem | ApproximateSchur) -> None:
        """Start without directions.

        Args:
            system: The exact dual system, of which S̃ is set up at the first call; or S̃.
        """
        self._system = system

    @cached_property
    def _subspace(self) -> RecycledSubspace:
        system = self._system
        if isinstance(system, DualSystem):
            system = ApproximateSchur(system)
        return RecycledSubspace(system)

    def __call__(self, residual: Array) -> Array:
        """S̃⁻¹ residual, shape (m,), nearly linear in it and positive definite."""
        goal = options.PRECONDITIONER_RESIDUAL * norm(residual)
        energies: list[float] = []

        def enough(answer: Array, rest: Array) -> bool:
            energies.append(float(answer @ residual))
            gained = np.inf
            if len(energies) > options.PRECONDITIONER_DELAY:
                gained = energies[-1] - energies[-1 - options.PRECONDITIONER_DELAY]
            settled = gained <= options.PRECONDITIONER_ENERGY**2 * energies[-1]
            return settled or norm(rest) <= goal

        most = options.MAX_DIRECTIONS - len(self._subspace)
        return conjugate_gradients(self._subspace, residual, np.copy, enough, most).y

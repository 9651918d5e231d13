"""Eq. 10 with off-the-shelf parts: algebraic multigrid under conjugate gradients.

With D the weighted measured rows, t their targets and u = L p - b, the objective is
‖u‖² + ‖D L⁻¹(u + b) - t‖², the identity plus a term of low rank:

    (I + L⁻ᵀDᵀD L⁻¹) u = L⁻ᵀDᵀ(t - D p₀),    p = p₀ + L⁻¹u,    p₀ = L⁻¹b.

SciPy's conjugate gradients take one solve with L and one with Lᵀ per step; each solve
is again SciPy's conjugate gradients, on the block A, preconditioned by a V-cycle of
pyamg. A baseline for `structured`.

See docs/method/solver-variants.md, Other solvers.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import LinearOperator, cg

from ttus_opt.core.arrays import Array
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.problem.members import StackedTerms
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import (
    Candidate,
    Capabilities,
    Claim,
    Solver,
    is_late,
)
from ttus_opt.solvers.dual.data import terms_beside
from ttus_opt.solvers.verified import Verified

#: Relative residual of the solves with A over that of u, and its least value
INNER, FLOOR = 1e-1, 1e-13

#: Most steps in u
STEPS = 2000


class _Loaded(Verified):
    margin, floor = 1e-1, 1e-12
    _laplace: LaplaceSystem | None = None
    _u: Array | None = None

    def _load(self, program: Program) -> None:
        """Take other data; keep the multigrid while L stays the same."""
        prior = program.laplace_term
        assert prior is not None
        if self._laplace is not program.laplace:
            self._set_up(program.laplace)
        measured = terms_beside(program, prior)
        stacked = StackedTerms.of(measured, program.n_variables, prior.weight)
        self._D, self._t = stacked.weighted, stacked.root * stacked.target
        self._b = prior.target

    def _set_up(self, laplace: LaplaceSystem) -> None:
        """A, its coupling to fixed voxels, and its multigrid."""
        import pyamg

        self._laplace, self._u, self._free = laplace, None, laplace.free
        self._r = laplace.radii[self._free]
        rows = sp.csr_array(sp.diags_array(-self._r) @ laplace.L[self._free])
        self._A = sp.csr_array(rows[:, self._free])
        self._coupling = sp.csr_array(rows[:, ~self._free])
        self._cycle = pyamg.ruge_stuben_solver(self._A).aspreconditioner(cycle="V")

    def _attempt(self, eps: float, deadline: float | None) -> Candidate:
        """Conjugate gradients in u from the last solution."""
        self._rtol, self._steps, D = max(INNER * eps, FLOOR), 0, self._D
        self._deadline = deadline
        try:
            p = self._solve(self._b)
            side = self._solve_adjoint(D.T @ (self._t - D @ p))
            operator = LinearOperator((len(p),) * 2, matvec=self._product, dtype=float)
            u, short = cg(operator, side, self._u, rtol=eps, maxiter=STEPS)
            self._u = np.asarray(u)
            p = p + self._solve(self._u)
        except TimeoutError:
            return Candidate(None, iterations=self._steps, claim=Claim.TIME_LIMIT)
        done = Claim.GAVE_UP if short else Claim.DONE
        return Candidate(p, iterations=self._steps, claim=done)

    def _product(self, u: Array) -> Array:
        """(I + L⁻ᵀDᵀD L⁻¹) u."""
        self._steps += 1
        sampled = self._D @ self._solve(u)
        return np.asarray(u + self._solve_adjoint(self._D.T @ sampled))

    def _solve(self, g: Array) -> Array:
        """L⁻¹g: identity rows give the fixed voxels, A the rest."""
        p, free = g.copy(), self._free
        p[free] = self._with_A(-self._r * g[free] - self._coupling @ g[~free])
        return p

    def _solve_adjoint(self, g: Array) -> Array:
        """L⁻ᵀg."""
        q, x = g.copy(), self._with_A(g[self._free])
        q[self._free] = -self._r * x
        q[~self._free] -= self._coupling.T @ x
        return q

    def _with_A(self, side: Array) -> Array:
        x, _ = cg(self._A, side, rtol=self._rtol, M=self._cycle, callback=self._check)
        return np.asarray(x)

    def _check(self, x: Array) -> None:
        if is_late(self._deadline):
            raise TimeoutError


class AmgPcg(Solver):
    """pyamg under two layers of SciPy's conjugate gradients; eq. 10 alone."""

    name = "amg_pcg"
    loaded = _Loaded
    summary = "off the shelf (pyamg, SciPy): AMG-CG for L under CG; a reference"
    capabilities = Capabilities(
        inequalities=False,
        equalities=False,
        any_terms=False,
        keeps="the multigrid of L, and the last answer to start from",
    )
    module = "pyamg"
    pip_name = '"ttus-opt[reference]"'

    def refusal(self, program: Program) -> str:
        """Takes eq. 10 only, without constraints."""
        if base := super().refusal(program):
            return base
        prior = program.laplace_term
        if prior is None or prior.weight == 0.0:
            return "it needs a Laplace term"
        others = [t for t in program.terms if t is not prior]
        eq10 = all(t.is_measured and t.is_squares for t in others)
        if not eq10 or set(program.variables) != {"p"}:
            return "it takes eq. 10 only"
        return ""


SOLVERS = [AmgPcg()]

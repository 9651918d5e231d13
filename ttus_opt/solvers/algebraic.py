"""Any sum of squares without a Laplace term: a factor or a multigrid.

Conjugate gradients on the normal equations of the values that are not given. The
preconditioner inverts the matrix of all short rows approximately
(`primal.sparse_inverse`) and takes the few long rows, those of measurements, by their
Schur complement. Differences of neighbouring voxels between given boundary values form
a network of conductances, which the grid's multigrid solves. With a Laplace term,
`normal_equations` is faster.

See docs/method/solver-variants.md, section 10.10.
"""

from __future__ import annotations

import math
import time
from functools import partial

import numpy as np
import scipy.sparse as sp

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.errors import MissingPackageError
from ttus_opt.laplace.network import NeighbourRows, by_network
from ttus_opt.problem.members import ProgramTerm
from ttus_opt.problem.program import Program
from ttus_opt.solvers.base import Candidate, Capabilities, Claim, Request, Solver
from ttus_opt.solvers.conjugate_gradients import Map, to_residual
from ttus_opt.solvers.dual.data import laplace_prior
from ttus_opt.solvers.primal.sparse_inverse import SparseInverse
from ttus_opt.solvers.proximal.field_preconditioner import with_few_rows
from ttus_opt.solvers.proximal.problem import PenalisedProblem
from ttus_opt.solvers.sizes import Sizes
from ttus_opt.solvers.verified import Verified

#: Mean entries per row from which a term's rows are long: MᵀM would fill in [–]
LONG = 64

#: Voxels from which a network is tried before a factor [–]
NETWORK = 30_000

#: Most steps of conjugate gradients per round; most rounds per solve, each from a
#: recomputed residual; relative residual at which a round ends at the latest [–]
STEPS, ROUNDS, ROUND = 500, 6, 1e-6


class Algebraic(Solver):
    """Conjugate gradients over a factor, the grid's multigrid or pyamg."""

    name = "algebraic"
    summary = (
        "any sum of squares without a Laplace term: a factor or a multigrid under "
        "conjugate gradients"
    )
    capabilities = Capabilities(
        inequalities=False,
        equalities=True,
        keeps="the factor or multigrid while weights stay, the last answer",
    )

    def refusal(self, program: Program) -> str:
        """Takes sums of squares without a Laplace term, and given values."""
        if base := super().refusal(program):
            return base
        others = [t.name for t in program.terms if not t.is_squares]
        if others:
            return f"{others[0]} is not a sum of squares"
        prior = laplace_prior(program)
        if prior is not None and prior.weight > 0.0:
            return f"it takes no Laplace term ({prior.name}): use normal_equations"
        for constraint in program.constraints:
            if (np.diff(constraint.matrix.indptr) != 1).any():
                return f"it takes given values, and {constraint.name} is more than that"
        return ""

    def cost(self, program: Program) -> float:
        """In proportion to the voxels."""
        s = Sizes.of(program)
        return 0.1 + 4e-5 * s.voxels

    def prepare(self, program: Program, request: Request) -> Verified:
        """Factorise, or set up the multigrid."""
        self.require(program)
        return _Loaded(program, request)


class _Loaded(Verified):
    margin, floor = 1e-2, 1e-15
    _last: Array | None = None
    _made: tuple[tuple[ProgramTerm, ...], Map, str] | None = None

    def _load(self, program: Program) -> None:
        """Take other data; keep the preconditioner while the matrices stay the same."""
        self._problem = problem = PenalisedProblem.of(program)
        self._missing = ""
        self._blocks = problem.blocks
        self._adjoints = [sp.csr_array(b.matrix.T) for b in self._blocks]
        terms = tuple(t for t in program.terms if t.weight > 0.0)
        if self._made is None or not _same(self._made[0], terms):
            self._made = None
            self._set_up(terms)
        at = problem.values if self._last is None else self._last
        self._x = np.where(problem.fixed, problem.values, at)

    def _set_up(self, terms: tuple[ProgramTerm, ...]) -> None:
        """Build the preconditioner."""
        moving = np.flatnonzero(~self._problem.fixed)
        short = [t for t in terms if not _is_long(t)] or list(terms)
        long = [t for t in terms if not any(t is k for k in short)]
        rows = [_scaled(t)[:, moving] for t in long]
        empty = sp.csr_array((0, len(moving)))
        few = sp.csr_array(sp.vstack([empty, *rows]))
        inverse = self._network(short, moving) or self._sparse(short, few, moving)
        if inverse is None:
            return
        apply: Map = with_few_rows(inverse.apply, few) if few.nnz else inverse.apply

        def precondition(v: Array) -> Array:
            z = np.zeros_like(v)
            z[moving] = apply(v[moving])
            return z

        self._made = terms, precondition, inverse.description

    def _network(
        self, short: list[ProgramTerm], moving: IntArray
    ) -> SparseInverse | None:
        """The grid's multigrid, where short rows are differences of neighbours.

        Args:
            short: Terms of short rows.
            moving: Variables without a given value.
        """
        program, fixed = self._problem.program, self._problem.fixed
        laplace, n = program.laplace, len(fixed)
        if laplace is None or n != len(laplace.free) or n < NETWORK:
            return None
        links, diagonal = np.zeros((3, n)), np.zeros(n)
        for term in short:
            matrix, slope = term.matrix, np.full(len(term.target), 2.0 * term.weight)
            links += NeighbourRows.of(matrix, laplace.grid).links(slope, n)
            size = 2.0 * term.weight * matrix.data**2
            diagonal += np.bincount(matrix.indices, size, n)
        free = laplace.free & ~fixed
        if (~laplace.free & ~fixed).any() or not (diagonal[free] > 0.0).all():
            return None
        cycle = by_network(laplace, links, diagonal, fixed)
        if cycle is None:
            return None

        def apply(v: Array) -> Array:
            whole = np.zeros(n)
            whole[moving] = v
            return np.asarray(cycle(whole)[moving])

        return SparseInverse(apply, "the grid's multigrid")

    def _sparse(
        self, short: list[ProgramTerm], few: sp.csr_array, moving: IntArray
    ) -> SparseInverse | None:
        """A factor or algebraic multigrid; None where pyamg is missing.

        Args:
            short: Terms of short rows.
            few: Long rows over the moving variables, shape (m, k).
            moving: Variables without a given value, shape (k,).
        """
        Q = _gram([_scaled(t)[:, moving] for t in short], len(moving))
        # a variable without short rows gets the diagonal of the long ones
        alone = Q.diagonal() == 0.0
        own = np.bincount(few.indices, few.data**2, len(moving))
        Q = sp.csr_array(
            Q + sp.diags_array(np.where(alone, np.where(own > 0.0, own, 1.0), 0.0))
        )
        try:
            return SparseInverse.of(Q)
        except MissingPackageError as error:
            self._missing = str(error)
            return None

    def _attempt(self, eps: float, seconds: float | None) -> Candidate:
        """Rounds of conjugate gradients from the last answer."""
        if self._made is None:
            return Candidate(None, claim=Claim.GAVE_UP, detail=self._missing)
        deadline = None if seconds is None else time.perf_counter() + seconds
        x, steps, before = self._x, 0, math.inf
        for _ in range(ROUNDS):
            parts = self._parts(x)
            largest = max((float(np.linalg.norm(g)) for g in parts), default=0.0)
            side = np.where(self._problem.fixed, 0.0, -np.sum(parts, axis=0))
            size = float(np.linalg.norm(side))
            late = deadline is not None and time.perf_counter() > deadline
            if size <= eps * largest or size > 0.5 * before or late:
                break
            before = size
            rtol = max(0.5 * eps * largest / size, ROUND)
            product = partial(self._product, self._problem.fixed)
            found = to_residual(product, side, self._made[1], rtol, STEPS, deadline)
            x, steps = x + found.y, steps + found.steps
        self._x = self._last = x
        parts = self._parts(x)
        duals = self._problem.duals(
            [self._charge(k, x) for k in range(len(self._blocks))],
            np.sum(parts, axis=0),
        )
        return Candidate(x, duals, steps, detail=f"{self._made[2]}, {steps} steps")

    def _charge(self, k: int, x: Array) -> Array:
        block = self._blocks[k]
        return 2.0 * block.weight * block.residual(x)

    def _parts(self, x: Array) -> list[Array]:
        """Gradients of the terms, shape (n,) each."""
        return [A @ self._charge(k, x) for k, A in enumerate(self._adjoints)] or [
            np.zeros_like(x)
        ]

    def _product(self, fixed: Mask, v: Array) -> Array:
        """The objective's curvature times a vector, shape (n,)."""
        out = np.zeros_like(v)
        for block, adjoint in zip(self._blocks, self._adjoints, strict=True):
            out += 2.0 * block.weight * (adjoint @ (block.matrix @ v))
        return np.where(fixed, 0.0, out)


def _is_long(term: ProgramTerm) -> bool:
    """Whether its rows are measurements, or have as many entries."""
    rows = max(term.matrix.shape[0], 1)
    return term.is_measured or term.matrix.nnz > LONG * rows


def _scaled(term: ProgramTerm) -> sp.csr_array:
    """Rows whose square is the term's curvature."""
    return sp.csr_array(np.sqrt(2.0 * term.weight) * term.matrix)


def _gram(matrices: list[sp.csr_array], n: int) -> sp.csr_array:
    total = sp.csr_array((n, n))
    for own in matrices:
        total = sp.csr_array(total + own.T @ own)
    total.sum_duplicates()
    return total


def _same(one: tuple[ProgramTerm, ...], other: tuple[ProgramTerm, ...]) -> bool:
    """Whether matrices and weights are the same."""
    return len(one) == len(other) and all(
        a.matrix is b.matrix and a.weight == b.weight
        for a, b in zip(one, other, strict=True)
    )


SOLVERS = [Algebraic()]

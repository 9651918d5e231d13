"""Minimisers of Σ (L p - b)²/ω + ‖W(D p - t)‖² for many weights W of the same rows.

The minimiser departs from p₀ = L⁻¹b by L⁻¹ω L⁻ᵀDᵀz with some multipliers z, whatever
the weights. So a few such *response fields* serve all weights: a reduced basis. They
are made orthonormal in the prior's energy, zᵢᵀC zⱼ = δᵢⱼ with C = D L⁻¹ω L⁻ᵀDᵀ. With K
the matrix of their measurements, Kⱼ = C zⱼ, the best combination for any weights is

    c = (1 + K W²Kᵀ)⁻¹ K W²d,   d = t - D p₀,   p = p₀ + Σ cⱼ L⁻¹ω L⁻ᵀDᵀzⱼ,

a system as small as the basis (Rayleigh-Ritz). What remains of the gradient is -2 Dᵀρ
with ρ = W²(d - Kᵀc) - Zᵀc, and the objective is at most ρᵀC ρ from its minimum. Where
that is too much, ρ, preconditioned for these weights, is a new direction: two solves.
KᵀK is the Nyström approximation of C (docs/method.md, section 10.9).
"""

from __future__ import annotations

import time
from dataclasses import dataclass, field, replace

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ttus_opt.arrays import Array, IntArray, Mask
from ttus_opt.problem.kkt import Duals
from ttus_opt.problem.program import Program
from ttus_opt.solvers.dual.data import DualData, laplace_prior
from ttus_opt.solvers.dual.options import DualOptions
from ttus_opt.solvers.dual.preconditioner import ApproximateSchur, schur_preconditioner

#: Relative residual of the solves behind a response field: an error there is an error
#: of every field made of it [–]
FIELD_RTOL = 1e-8

#: Most rows and voxels: 60 response fields of the latter take 2 GiB
MOST_ROWS, MOST_VOXELS = 50_000, 4_000_000

#: Random multipliers whose mean energy counts
PROBES = 8

#: Response fields that share one array
BLOCK = 16

#: By how much a limit may be missed, over the largest value [–]
ROUNDING = 1e-12

#: A direction of which no more than this is left across the others is none [–]
DEPENDENT = 1e-10

#: Energy that a direction may share with the others, over its own: they are orthogonal
#: up to the error of the solves, and beyond this the direction is that error [–]
SHARED = 1e-4


def suits_sweep(program: Program) -> bool:
    """Whether a program that `structured` takes is one field and few measured rows.

    These must be all there is beside the Laplace term, and the response fields must
    find room. Limits do not matter: where the minimiser without them keeps them, it is
    the minimiser with them (`keeps_limits`).
    """
    prior, V = laplace_prior(program), len(program.laplace.free)
    if prior is None or program.n_variables != V:
        return False
    rows = sum(len(t.target) for t in program.terms if t is not prior)
    return rows <= min(V // 2, MOST_ROWS) and V <= MOST_VOXELS


def is_limited(program: Program) -> bool:
    """Whether there are limits beside hard boundary values."""
    return bool(program.bounds) or any(
        constraint is not program.dirichlet for constraint in program.constraints
    )


def keeps_limits(program: Program, x: Array) -> bool:
    """Whether a point keeps all limits but hard boundary values, up to rounding."""
    least = -ROUNDING * float(np.abs(x).max(initial=0.0))
    slacks = [bound.slack(x) for bound in program.bounds]
    slacks += [c.slack(x) for c in program.constraints if c is not program.dirichlet]
    return all(float(slack.min(initial=0.0)) >= least for slack in slacks)


def value_duals(program: Program, x: Array) -> Duals:
    """Multipliers of hard boundary values at a minimiser, shape (V,)."""
    given = program.dirichlet
    if given is None:
        return Duals()
    slope = -np.add(*program.gradient(x))
    return Duals({given.name: slope[~program.laplace.free]})


@dataclass(frozen=True)
class SweepAnswer:
    """The minimiser for one set of weights.

    Attributes:
        p: Shape (V,).
        directions: Response fields that it took beyond those there were [–].
        settled: Whether the energy of the gradient fell to what was asked for.
    """

    p: Array = field(repr=False)
    directions: int
    settled: bool


class WeightSweep:
    """A reduced basis of one problem, growing as weights ask for it."""

    def __init__(
        self,
        data: DualData,
        options: DualOptions | None = None,
        field_rtol: float = FIELD_RTOL,
        voxels: IntArray | None = None,
    ) -> None:
        """Solve for p₀; the basis is empty.

        Args:
            data: A problem without limits and without unknowns beside the field.
            options: Of the preconditioner; None for the defaults.
            field_rtol: Relative residual of the solves behind a response field [–].
            voxels: Where response fields are kept, shape (n,), in single precision:
                `complete` takes no more, `solve` all; None for everywhere.
        """
        self._field_rtol = field_rtol
        self._voxels = slice(None) if voxels is None else voxels
        self._kept_as = np.float64 if voxels is None else np.float32
        assert not data.columns.shape[1]
        system = data.system
        # rows without an entry say nothing of the field
        self._told = np.diff(system.rows.indptr) > 0
        root = system.root_weights[self._told]
        self._system = replace(system, rows=system.rows[self._told], root_weights=root)
        self._options = options or DualOptions()
        self._base = system.laplace.solve(data.b)
        said = np.asarray(self._system.rows @ self._base)
        self._misfit: Array = data.t[self._told] / root - said
        self._multipliers = np.empty((0, len(root)))
        self._images = np.empty((0, len(root)))
        self._fields: list[NDArray[np.floating]] = []
        self._approximate: ApproximateSchur | None = None

    def __len__(self) -> int:
        """Number of response fields."""
        return len(self._images)

    @property
    def told(self) -> Mask:
        """Rows of the data that say something of the field, shape (m,)."""
        return self._told

    @property
    def misfit(self) -> Array:
        """What these rows measured beyond p₀, without weights, d, shape (rows,)."""
        return self._misfit

    @property
    def images(self) -> Array:
        """What they measure of the response fields, K, shape (k, rows)."""
        return self._images

    @property
    def base(self) -> Array:
        """The prior's mean p₀, shape (V,)."""
        return self._base

    def take_fields(self) -> NDArray[np.floating]:
        """Hand over the response fields where they are kept, shape (k, n).

        They take most of the memory there is and are in it once: the basis keeps its
        images alone.
        """
        out = np.empty((len(self), len(self._base[self._voxels])), self._kept_as)
        for start in range(0, len(self), BLOCK):
            block = self._fields.pop(0)
            out[start : min(start + BLOCK, len(self))] = block[: len(self) - start]
        return out

    def complete(self, root_weights: Array, missing: float = 0.5) -> bool:
        """Add response fields until the basis holds C for these weights and smaller.

        Multipliers W g with a random g of unit variance: the energy that such a one has
        beyond the basis is on average tr W(C - KᵀK)W, by which log det(1 + WCW) is too
        small at most (Halko, Martinsson and Tropp, SIAM Rev. 53, 2011).

        Args:
            root_weights: W, the largest there will be, shape (m,) [–].
            missing: Trace to reach, the mean of the last `PROBES` [–].

        Returns:
            Whether it was reached.
        """
        root, random = root_weights[self._told], np.random.default_rng(0)
        recent: list[float] = []
        while len(self) < min(len(root), self._options.max_directions):
            recent.append(self._extend(root * random.standard_normal(len(root))))
            if len(recent) >= PROBES and np.mean(recent[-PROBES:]) <= missing:
                return True
        return len(self) >= len(root)

    def solve(
        self, root_weights: Array, rtol: float, deadline: float | None = None
    ) -> SweepAnswer:
        """Minimise for one set of weights.

        Args:
            root_weights: W, of all rows of the data, shape (m,) [–].
            rtol: Largest energy of the error, as a root and over that of the objective:
                √(ρᵀC ρ / objective) [–].
            deadline: `time.perf_counter` at which to stop; None for never [s].
        """
        root = root_weights[self._told]
        self._system = replace(self._system, root_weights=root)
        if self._approximate is None and len(root):
            self._approximate = ApproximateSchur(self._system)
        before, least, best = len(self), np.inf, np.zeros(len(self))
        precondition = None
        settled = False
        while True:
            c, rest = self._best(root)
            y, error = rest / root, 0.0
            if self._approximate is not None:
                self._approximate.root_weights = root
                error = float(y @ (self._approximate.apply(y) - y))
            left = root * (self._misfit - c @ self._images)
            objective = float(c @ c + left @ left)
            settled = error <= rtol**2 * objective
            if error < least:
                least, best = error, c
            late = deadline is not None and time.perf_counter() > deadline
            taken = len(self) - before
            if settled or late or taken == self._options.max_directions:
                break
            if precondition is None:
                precondition = schur_preconditioner(
                    self._system, self._options, self._approximate
                )
            if not self._extend(root * precondition(y)):
                break
        p = self._base + self._combined(best)
        return SweepAnswer(p, len(self) - before, settled)

    def _best(self, root: Array) -> tuple[Array, Array]:
        """Coefficients of the best combination, and ρ, shape (rows,)."""
        weighted = self._images * root
        gram = weighted @ weighted.T
        gram[np.diag_indices_from(gram)] += 1.0
        c = scipy.linalg.solve(
            gram, weighted @ (root * self._misfit), assume_a="pos", check_finite=False
        )
        rest = root * (root * self._misfit - c @ weighted) - c @ self._multipliers
        return c, rest

    def _extend(self, multipliers: Array) -> float:
        """Add the response field of some multipliers, orthonormal to the others.

        Returns:
            The energy that it had beyond them; 0 where there is nothing to add.
        """
        z, size = multipliers, float(np.linalg.norm(multipliers))
        for _ in range(2):  # twice is enough
            z = z - (self._images @ z) @ self._multipliers
        if not (np.isfinite(z).all() and np.linalg.norm(z) > DEPENDENT * size):
            return 0.0
        response = self._response(z)
        image = self._system.rows @ response
        square = float(z @ image)
        if not (np.isfinite(square) and square > 0.0):
            return 0.0
        shared = self._multipliers @ image
        if float(shared @ shared) > SHARED * square:
            return 0.0
        unit = 1.0 / np.sqrt(square)
        self._multipliers = np.vstack([self._multipliers, unit * z])
        self._images = np.vstack([self._images, unit * image])
        at, kept = (len(self) - 1) % BLOCK, response[self._voxels]
        if at == 0:
            self._fields.append(np.empty((BLOCK, len(kept)), self._kept_as))
        self._fields[-1][at] = unit * kept
        return square

    def _response(self, multipliers: Array) -> Array:
        """L⁻¹ω L⁻ᵀDᵀz, shape (V,)."""
        return self._system.response(
            multipliers / self._system.root_weights, self._field_rtol
        )

    def _combined(self, c: Array) -> Array:
        """Σ cⱼ times the response fields, shape (V,)."""
        out = np.zeros_like(self._base)
        for start, fields in zip(range(0, len(c), BLOCK), self._fields, strict=False):
            part = c[start : start + BLOCK]
            out += part @ fields[: len(part)]
        return out

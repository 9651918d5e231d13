"""Minimisers of Σ (L p - b)²/ω + ‖W(D p - t)‖² for many weights W of the same rows.

Whatever the weights, the minimiser is p₀ = L⁻¹b plus a *response field* L⁻¹ω L⁻ᵀDᵀz
with some multipliers z. A few of these suffice for all weights: a reduced basis. They
are orthonormal in the energy norm of the prior, zᵢᵀC zⱼ = δᵢⱼ with C = D L⁻¹ω L⁻ᵀDᵀ.
With K the matrix of their measurements, Kⱼ = C zⱼ, the best combination for any weights
solves a system as small as the basis (Rayleigh-Ritz):

    c = (1 + K W²Kᵀ)⁻¹ K W²d,   d = t - D p₀,   p = p₀ + Σ cⱼ L⁻¹ω L⁻ᵀDᵀzⱼ.

The gradient there is -2 Dᵀρ with ρ = W²(d - Kᵀc) - Zᵀc, and the objective is at most
ρᵀC ρ above its minimum. If that is too large, ρ, preconditioned for these weights,
gives a new response field, at two solves. KᵀK is the Nyström approximation of C
(docs/method/solver.md, section 10.9).
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.gaussian.conditioned import ByImages
from ttus_opt.solvers.base import is_late
from ttus_opt.solvers.conjugate_gradients import norm
from ttus_opt.solvers.dual import options
from ttus_opt.solvers.dual.data import DualData
from ttus_opt.solvers.dual.preconditioner import ApproximateSchur, SchurPreconditioner

#: Relative residual of the solves for a response field; its error passes to all fields
FIELD_RTOL = 1e-8

#: Random multipliers whose mean energy estimates a trace
PROBES = 8

#: Response fields that share one array
BLOCK = 16

#: Relative threshold below which a direction is dropped as dependent [–]
DEPENDENT = 1e-10

#: Largest energy that a direction may share with the others, over its own: beyond this
#: it is nothing but the error of the solves [–]
SHARED = 1e-4


@dataclass(frozen=True)
class SweepAnswer:
    """The minimiser for one set of weights.

    Attributes:
        p: The minimiser, shape (V,).
        directions: Number of response fields added for it [–].
        settled: Whether the energy of the gradient fell to the tolerance.
    """

    p: Array = field(repr=False)
    directions: int
    settled: bool


class WeightSweep:
    """A reduced basis of one problem, which grows with the weights solved for.

    Attributes:
        informative: Which rows of the data depend on the field, shape (m,).
        misfit: d = t - D p₀ of these rows, without weights, shape (rows,).
        base: The prior's mean p₀, shape (V,).
    """

    def __init__(
        self,
        data: DualData,
        field_rtol: float = FIELD_RTOL,
        voxels: IntArray | None = None,
    ) -> None:
        """Solve for p₀; the basis is empty.

        Args:
            data: A problem without limits and without unknowns beside the field.
            field_rtol: Relative residual of the solves for a response field [–].
            voxels: Voxels at which response fields are stored, in single precision,
                shape (n,): enough for `complete`, while `solve` needs all; None for
                all.
        """
        self._field_rtol = field_rtol
        self._voxels = slice(None) if voxels is None else voxels
        self._kept_as = np.float64 if voxels is None else np.float32
        assert not data.columns.shape[1]
        system = data.system
        # rows without an entry do not depend on the field
        self.informative = np.diff(system.rows.indptr) > 0
        root = system.root_weights[self.informative]
        self._system = replace(
            system, rows=system.rows[self.informative], root_weights=root
        )
        self.base = system.laplace.solve(data.b)
        said = np.asarray(self._system.rows @ self.base)
        self.misfit: Array = data.t[self.informative] / root - said
        self._count = 0
        #: Multipliers and their images, with room for more
        self._stored = np.empty((2, BLOCK, len(root)))
        self._fields: list[NDArray[np.floating]] = []
        self._approximate: ApproximateSchur | None = None

    def __len__(self) -> int:
        """Number of response fields."""
        return self._count

    @property
    def _multipliers(self) -> Array:
        """Z, shape (k, rows)."""
        return self._stored[0, : self._count]

    @property
    def images(self) -> Array:
        """K, measurements of the response fields, shape (k, rows)."""
        return self._stored[1, : self._count]

    def take_fields(self) -> NDArray[np.floating]:
        """Hand over the response fields at the stored voxels, shape (k, n).

        They take most of the memory, so the basis does not keep a copy of them.
        """
        out = np.empty((len(self), len(self.base[self._voxels])), self._kept_as)
        for start in range(0, len(self), BLOCK):
            block = self._fields.pop(0)
            out[start : min(start + BLOCK, len(self))] = block[: len(self) - start]
        return out

    def complete(self, root_weights: Array, missing: float = 0.5) -> bool:
        """Add response fields until KᵀK approximates C up to these weights.

        Their multipliers are W g with random g of unit variance. The mean energy of
        such multipliers outside the basis is tr W(C - KᵀK)W, which bounds the error of
        log det(1 + WCW) (Halko, Martinsson and Tropp, SIAM Rev. 53, 2011).

        Args:
            root_weights: W, the largest that will be used, shape (m,) [–].
            missing: Trace at which to stop, the mean of the last `PROBES` [–].

        Returns:
            Whether it was reached.
        """
        root, random = root_weights[self.informative], np.random.default_rng(0)
        recent: list[float] = []
        most = min(len(root), options.MAX_DIRECTIONS)
        while (begun := len(self)) < most:
            probes = root * random.standard_normal((PROBES, len(root)))
            # all at once against what there is, then one after another
            for z, probe in zip(
                self._without(probes), probes[: most - begun], strict=False
            ):
                recent.append(self._extend(self._without(z, begun), norm(probe)))
                if len(recent) >= PROBES and np.mean(recent[-PROBES:]) <= missing:
                    return True
        return len(self) >= len(root)

    def solve(
        self, root_weights: Array, rtol: float, deadline: float | None = None
    ) -> SweepAnswer:
        """Minimise for one set of weights.

        Args:
            root_weights: W, for all rows of the data, shape (m,) [–].
            rtol: Largest relative error in the energy norm, √(ρᵀC ρ / objective) [–].
            deadline: `time.perf_counter` at which to stop [s]; None for never.
        """
        root = root_weights[self.informative]
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
            left = root * (self.misfit - c @ self.images)
            objective = float(c @ c + left @ left)
            settled = error <= rtol**2 * objective
            if error < least:
                least, best = error, c
            taken = len(self) - before
            if settled or is_late(deadline) or taken == options.MAX_DIRECTIONS:
                break
            if precondition is None:
                of = self._approximate or self._system
                precondition = SchurPreconditioner(of)
            wanted = root * precondition(y)
            if not self._extend(self._without(wanted), norm(wanted)):
                break
        p = self.base + self._combined(best)
        return SweepAnswer(p, len(self) - before, settled)

    def _best(self, root: Array) -> tuple[Array, Array]:
        """Coefficients of the best combination, and ρ, shape (rows,)."""
        weighted, misfit = self.images * root, root * self.misfit
        c = ByImages.of(weighted, misfit).coefficients(misfit)
        return c, root * (misfit - c @ weighted) - c @ self._multipliers

    def _without(self, multipliers: Array, since: int = 0) -> Array:
        """Multipliers less their part in the basis from ``since`` on, (..., rows)."""
        z = multipliers
        for _ in range(2):  # twice is enough
            z = z - (z @ self.images[since:].T) @ self._multipliers[since:]
        return z

    def _extend(self, z: Array, size: float) -> float:
        """Add the response field of some multipliers.

        Args:
            z: Orthogonal to the basis, shape (rows,).
            size: What they measured before they were made so.

        Returns:
            Their energy; 0 if there is nothing to add.
        """
        if not (np.isfinite(z).all() and norm(z) > DEPENDENT * size):
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
        at, kept = len(self) % BLOCK, response[self._voxels]
        if len(self) == self._stored.shape[1]:
            self._stored = np.concatenate(2 * [self._stored], axis=1)
        self._stored[:, len(self)] = unit * z, unit * image
        self._count += 1
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
        out = np.zeros_like(self.base)
        for start, fields in zip(range(0, len(c), BLOCK), self._fields, strict=False):
            part = c[start : start + BLOCK]
            out += part @ fields[: len(part)]
        return out

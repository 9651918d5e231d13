"""Eq. 10 block by block, with one unknown per touched functional (design §3).

With D the weighted measured rows, t their targets and p₀ = L⁻¹b, the minimiser of
‖L p - b‖² + ‖D p - t‖² is the mean of p ~ Normal(p₀, (LᵀL)⁻¹) after t = D p + noise of
variance 1. D = C Φ touches few functionals Φ (`ttus_opt.functionals`); their prior
covariance is G = Φ L⁻¹L⁻ᵀΦᵀ, a column of which costs one solve with Lᵀ and one with L,
and `ttus_opt.posterior` has their covariance Σ, mean m and sources u with all blocks
held. The field is

    p = p₀ + L⁻¹L⁻ᵀΦᵀ u.

Where a pose touches no new voxel, an update has no solve at all. Where it touches
more than `BUDGET` of them, its rows at these voxels become functionals themselves (a
tail), and what is left of the budget resolves the voxels that weigh most; when later
poses have resolved the rest, the rows are written with the voxels and the tail goes.
So a pose costs at most `BUDGET` columns, and k stays near the number of voxels touched.

The columns need not be exact: the field's own solves tell what G u is, and u is
corrected until the two agree to `FIELD_RTOL`.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from ttus_opt.errors import InputError, NumericalError
from ttus_opt.functionals import Block, Combination, Functionals, Tail
from ttus_opt.laplace import RTOL, LaplaceSystem
from ttus_opt.posterior import Outlook, Posterior, warm_up

Array = NDArray[np.float64]

#: Most functionals that one block may add, two solves each
BUDGET = 9

#: Change of the field, in the norm of L and relative to what the data changed, at
#: which it is no longer corrected, and most rounds
FIELD_RTOL, FIELD_ROUNDS = 1e-11, 12

#: Largest relative residual of the solves behind a column of G, and the error of a
#: block's prior covariance, in units of the noise's, that it may make
COLUMN_RTOL, COLUMN_ERROR = 1e-6, 1e-6

#: Innovation covariances are at least one; below this, rounding has taken over
LEAST_SCHUR = 0.9


@dataclass(frozen=True)
class Forecast:
    """A block of m new rows, seen from what is held.

    Attributes:
        block: The rows.
        tail: Their part at voxels that are not resolved; None where all are.
        combination: The rows as sums of functionals.
        outlook: Their mean beyond p₀ and its spread.
        prior: D p₀, shape (m,).
    """

    block: Block
    tail: Tail | None
    combination: Combination
    outlook: Outlook
    prior: Array

    @property
    def schur(self) -> Array:
        """S, covariance of the innovation, shape (m, m)."""
        return self.outlook.schur

    @property
    def mean(self) -> Array:
        """Predicted measurement, shape (m,)."""
        out: Array = self.prior + self.outlook.mean
        return out


@dataclass(frozen=True)
class _Held:
    """A block that was taken in.

    Attributes:
        block: Its rows, with the weight they have now.
        tail: Its tail, if it still has one.
        scale: Its weight now over that with which the tail was made [–].
        beyond: t - D p₀, with the weight of now, shape (m,).
    """

    block: Block
    tail: Tail | None
    scale: float
    beyond: Array


class FunctionalRecursion:
    """The blocks held, and the field they make.

    Memory is three k × k arrays for k touched functionals, with room to grow, and
    the sparse rows of the blocks, so that they can be taken out again, beside three
    vectors of V and a number per voxel.

    Attributes:
        height: Rows per block, m [–].
        prior_field: p₀, the Laplace field, shape (V,).
    """

    def __init__(self, laplace: LaplaceSystem, b: Array, *, height: int) -> None:
        """Start without measurements: one solve for p₀, and compiling.

        Args:
            laplace: L.
            b: Right side of L p = b, shape (V,).
            height: Rows per block [–].
        """
        self.height = height
        self._laplace = laplace
        self._functionals = Functionals(laplace.grid.n_voxels)
        self._posterior = Posterior()
        self._held: list[_Held] = []
        # tail of a block that was forecast and not taken in
        self._loose: Tail | None = None
        # p - p₀, its LᵀL (p - p₀) = Φᵀu, and whether they are those of what is held
        self._shift = np.zeros(laplace.grid.n_voxels)
        self._source = np.zeros(laplace.grid.n_voxels)
        self._is_current = True
        # residual of the solves behind columns, smaller where weights are large
        self._column_rtol = COLUMN_RTOL
        self.prior_field = laplace.solve(b)
        warm_up(height)

    def __len__(self) -> int:
        """Number of blocks held [–]."""
        return len(self._held)

    @property
    def n_functionals(self) -> int:
        """Functionals k there are; those of voxels stay when blocks go [–]."""
        return len(self._functionals)

    @property
    def memory_bytes(self) -> int:
        """Size of what grows with the measurements."""
        rows = sum(
            h.block.values.nbytes + h.block.voxels.nbytes + h.beyond.nbytes
            for h in self._held
        )
        return self._posterior.memory_bytes + self._functionals.memory_bytes + rows

    @property
    def misfit(self) -> float:
        """Sum of the squares of all whitened innovations; least value of eq. 10."""
        return self._posterior.misfit

    def forecast(self, block: Block) -> Forecast:
        """Predict new rows from all that is held.

        Costs two solves per functional that is new, at most `BUDGET` of these side by
        side on all cores, and O(k²). What was learnt of G is kept, the rows are not.

        Args:
            block: The new rows.

        Raises:
            InputError: Shapes that do not fit, or a voxel that is not there.
            NumericalError: Weights so large that rounding takes over.
        """
        if block.values.shape != (len(block.voxels), self.height):
            raise InputError(
                f"a block needs values of shape ({len(block.voxels)}, {self.height}), "
                f"got {block.values.shape}"
            )
        self._drop_loose()
        tail = self._loose = self._cover(block)
        C = self._functionals.combination(block, tail, 1.0)
        outlook = self._posterior.outlook(C)
        if not _is_sound(outlook.schur):
            self._posterior.refresh()
            outlook = self._posterior.outlook(C)
        if not _is_sound(outlook.schur):
            least = float(np.linalg.eigvalsh(outlook.schur)[0])
            raise NumericalError(
                f"the innovation's covariance is {least:.2g} of the noise where it is "
                "at least 1: the weights are too large for the solves, lower them"
            )
        prior = self.prior_field[block.voxels] @ block.values
        return Forecast(block, tail, C, outlook, prior)

    def append(self, forecast: Forecast, target: Array) -> None:
        """Take the rows of a forecast in; O(k²).

        Args:
            forecast: Made by `forecast` since the last change, the latest one.
            target: What was measured, weighted as the rows, shape (m,).
        """
        beyond = target - forecast.prior
        self._posterior.append(forecast.combination, forecast.outlook, beyond)
        self._held.append(_Held(forecast.block, forecast.tail, 1.0, beyond))
        self._loose = None
        self._is_current = False

    def remove(self, start: int, count: int) -> None:
        """Take blocks start to start + count out; O(k²) each, at most O(k³) in all.

        Raises:
            InputError: Blocks that are not there.
        """
        held = len(self)
        if start < 0 or count < 0 or start + count > held:
            raise InputError(
                f"blocks {start} to {start + count} are not within 0 to {held}"
            )
        if count == 0:
            return
        self._drop_loose()
        gone = self._held[start : start + count]
        del self._held[start : start + count]
        if not self._held:
            self._posterior.clear()
        elif count > max(8, self.n_functionals // 4):
            # so many at once cost more than making Σ anew
            for each in gone:
                self._posterior.forget(self._combination(each), each.beyond)
            self._posterior.refresh()
        else:
            for each in gone:
                self._posterior.remove(self._combination(each), each.beyond)
        for each in gone:
            if each.tail is not None:
                self._drop(each.tail)
        self._is_current = False

    def fade(self, factor: float) -> None:
        """Multiply the weight of every row held; O(k³).

        Args:
            factor: In (0, 1] [–].

        Raises:
            InputError: factor is not within these.
        """
        if not 0.0 < factor <= 1.0:
            raise InputError(f"a fading factor must lie in (0, 1], got {factor}")
        self._drop_loose()
        root = float(np.sqrt(factor))
        self._posterior.fade(factor)
        self._held = [
            _Held(
                Block(h.block.voxels, h.block.values * root),
                h.tail,
                h.scale * root,
                h.beyond * root,
            )
            for h in self._held
        ]
        self._is_current = False

    def field(self) -> Array:
        """Make p, shape (V,).

        Nothing but a copy if nothing changed, else two solves with A and O(k²) for what
        changed, and quick ones once more where the columns of G were not good enough.

        Raises:
            NumericalError: `FIELD_RTOL` was not reached.
        """
        if not self._is_current:
            self._drop_loose()
            try:
                self._move_shift()
            except NumericalError:
                # nothing that did not converge is built upon
                self._shift, self._source = (np.zeros_like(self._shift) for _ in "ps")
                raise
            self._is_current = True
        out: Array = self.prior_field + self._shift
        return out

    def _move_shift(self) -> None:
        """Bring L⁻¹L⁻ᵀΦᵀu up to date, u corrected until G u is what the solves say."""
        functionals, posterior = self._functionals, self._posterior
        u = posterior.sources
        for _ in range(FIELD_ROUNDS):
            source = functionals.adjoint(u)
            more = source - self._source
            size, change = _length(source), _length(more)
            if change >= size:
                # nothing is saved, and errors would stay: begin anew
                self._shift = np.zeros_like(self._shift)
                more, change = source, size
            if change > 0.0:
                # a small change need not be known to as many digits
                rtol = min(max(RTOL, RTOL * size / change), 1e-4)
                self._shift = self._shift + self._inverse(more, rtol)
                self._source = source
            x = functionals.of(self._shift)
            step = posterior.step(u, x)
            now = posterior.energy(step)
            size = float(np.sqrt(max(np.sum(u * x), 0.0)))
            if now <= FIELD_RTOL * size:
                posterior.set_mean(x)
                return
            u = u + step
        raise NumericalError(
            f"the field still changes by {now / size:.1e} after {FIELD_ROUNDS} rounds, "
            f"{FIELD_RTOL:.0e} was asked for: the weights are too large for the "
            "solves, lower them"
        )

    def _inverse(self, source: Array, rtol: float) -> Array:
        """L⁻¹L⁻ᵀ of a vector."""
        laplace = self._laplace
        return laplace.solve(laplace.solve_adjoint(source, rtol=rtol), rtol=rtol)

    def _cover(self, block: Block) -> Tail | None:
        """Add functionals until the block's rows are sums of them."""
        functionals = self._functionals
        rest = functionals.unresolved(block.voxels)
        at = np.flatnonzero(rest)
        if len(at) == 0:
            return None
        if len(at) > BUDGET:
            weight = np.sum(block.values[at] ** 2, axis=1)
            at = np.sort(at[np.argsort(-weight)[: max(BUDGET - self.height, 0)]])
        rest[at] = False
        left = block.voxels[rest]
        new = [Block(block.voxels[at], np.eye(len(at)))]
        if len(left):
            new.append(Block(left, block.values[rest]))
        # the solves may fail: nothing has changed before them
        # rows at their largest: all voxels alike, and as uncertain as the worst, where
        # a fixed one has variance 1
        reach = float(np.max(np.sum(np.abs(block.values), axis=0))) ** 2
        rtol = self._column_tolerance(reach)
        cross, own = self._columns(new, rtol)
        worst = np.diag(own)[: len(at)].max(initial=1.0)
        needed = self._column_tolerance(max(reach * worst, np.diag(own).max()))
        if needed < rtol:
            cross, own = self._columns(new, needed)
        self._posterior.extend(cross, own)
        functionals.resolve(block.voxels[at])
        tail = functionals.add_tail(block, rest) if len(left) else None
        self._resolve_tails()
        return tail

    def _column_tolerance(self, variance: float) -> float:
        """Residual of the solves for rows that vary so much; never larger again."""
        needed = COLUMN_ERROR / max(variance, 1e-300)
        self._column_rtol = min(self._column_rtol, max(needed, RTOL))
        return self._column_rtol

    def _columns(self, new: list[Block], rtol: float) -> tuple[Array, Array]:
        """Covariances of new functionals with those there are, and among them.

        Args:
            new: The functionals, as columns of blocks.
            rtol: Relative residual of the solves [–].

        Returns:
            Shapes (n, k) and (n, n).
        """
        n = sum(part.values.shape[1] for part in new)
        cross, own = np.empty((n, len(self._functionals))), np.empty((n, n))
        chains = [(part, c) for part in new for c in range(part.values.shape[1])]

        def chain(a: int) -> None:
            part, c = chains[a]
            row = np.zeros(self._laplace.grid.n_voxels)
            row[part.voxels] = part.values[:, c]
            x = self._inverse(row, rtol)
            cross[a] = self._functionals.of(x)
            own[a] = np.concatenate([x[p.voxels] @ p.values for p in new])

        with ThreadPoolExecutor(min(n, len(os.sched_getaffinity(0)))) as pool:
            list(pool.map(chain, range(n)))
        return cross, 0.5 * (own + own.T)

    def _combination(self, held: _Held) -> Combination:
        return self._functionals.combination(held.block, held.tail, held.scale)

    def _resolve_tails(self) -> None:
        """Write blocks with voxels whose tails have all their voxels resolved."""
        for i, held in enumerate(self._held):
            tail = held.tail
            if tail is None or self._functionals.unresolved(tail.part.voxels).any():
                continue
            after = replace(held, tail=None)
            # the rows are the same: Σ and m do not change
            self._posterior.account(self._combination(held), held.beyond, -1.0)
            self._posterior.account(self._combination(after), held.beyond, 1.0)
            self._held[i] = after
            self._drop(tail)

    def _drop_loose(self) -> None:
        """Take out the tail of a block that was not taken in."""
        if self._loose is not None:
            self._drop(self._loose)
            self._loose = None

    def _drop(self, tail: Tail) -> None:
        self._posterior.drop(self._functionals.drop_tail(tail))


def _is_sound(schur: Array) -> bool:
    return bool(np.linalg.eigvalsh(schur)[0] >= LEAST_SCHUR)


def _length(x: Array) -> float:
    """2-norm; the sum and not BLAS, whose threads wait on each other."""
    return float(np.sqrt(np.sum(x * x)))

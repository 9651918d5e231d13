"""Mean and covariance of k functionals of the field, as measurements come and go.

A priori the functionals (`ttus_opt.functionals`) are Normal(0, G), measured from their
values at p₀; a block of measured rows says C x = d + noise of variance 1. With

    M = Σ CᵀC,    h = Σ Cᵀd,    s = Σ ‖d‖²

over the blocks held, the covariance and the mean are

    Σ = (G⁻¹ + M)⁻¹ = G (I + M G)⁻¹,    m = Σ h = G u,    (I + M G) u = h.

Σ is kept as it is, and G⁻¹ is never formed: G may be singular. A block changes Σ by
a matrix of rank m,

    Σ → Σ ∓ ΣCᵀ (I ± C Σ Cᵀ)⁻¹ CΣ    (upper signs: the block comes; lower: it goes),

in O(k²), however many blocks are held. From u = h - M m and (I + M G)⁻¹ = I - M Σ
everything else follows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg
from numpy.typing import NDArray

from ttus_opt.compiled import compiled
from ttus_opt.errors import NumericalError
from ttus_opt.functionals import ROOM, Combination, Slots

Array = NDArray[np.float64]

#: Least eigenvalue of I - C Σ Cᵀ with which a block is taken out of Σ: rounding grows
#: by its inverse; below it, and after so many removals, Σ is made anew
LEAST_LEFT, MOST_REMOVALS = 1e-3, 1000


@dataclass(frozen=True)
class Outlook:
    """A block seen from what is held.

    Attributes:
        gain: C Σ, shape (m, k).
        schur: I + C Σ Cᵀ, covariance of its innovation, shape (m, m).
        mean: C m, shape (m,).
    """

    gain: Array
    schur: Array
    mean: Array


class Posterior:
    """G, M, Σ, h, m and s.

    Memory is three k × k arrays with room to grow.
    """

    def __init__(self) -> None:
        self._size = 0
        self._G, self._M, self._S = (np.zeros((ROOM, ROOM)) for _ in range(3))
        self._h, self._m = np.zeros(ROOM), np.zeros(ROOM)
        self._s = 0.0
        self._removals = 0

    def __len__(self) -> int:
        """Number of functionals k [–]."""
        return self._size

    @property
    def memory_bytes(self) -> int:
        """Size of the arrays, room to grow included."""
        return 3 * self._G.nbytes + self._h.nbytes + self._m.nbytes

    @property
    def covariance(self) -> Array:
        """Σ, a copy, shape (k, k)."""
        return self._S[: self._size, : self._size].copy()

    @property
    def mean(self) -> Array:
        """The m, a copy, shape (k,)."""
        return self._m[: self._size].copy()

    @property
    def sources(self) -> Array:
        """The u, with which m = G u, shape (k,)."""
        k = self._size
        out: Array = self._h[:k] - _products(self._M, self._m[None, :k])[0]
        return out

    @property
    def misfit(self) -> float:
        """Sum of the squared whitened innovations of all rows held, s - hᵀm."""
        return max(self._s - float(np.sum(self._h * self._m)), 0.0)

    def energy(self, u: Array) -> float:
        """√(uᵀ G u): prior standard deviation of uᵀ x.

        Args:
            u: One number per functional, shape (k,).
        """
        return float(np.sqrt(max(np.sum(u * _products(self._G, u[None])[0]), 0.0)))

    def step(self, u: Array, x: Array) -> Array:
        """The correction of u, where G u turned out to be x.

        (I + M G)⁻¹ (h - u - M x), by I - M Σ.

        Args:
            u: Sources at hand, shape (k,).
            x: G u as known best, shape (k,).
        """
        k = self._size
        residual = self._h[:k] - u - _products(self._M, x[None])[0]
        shift = _products(self._S, residual[None])
        out: Array = residual - _products(self._M, shift)[0]
        return out

    def set_mean(self, x: Array) -> None:
        """Take over a mean that is known better.

        Args:
            x: The m, shape (k,).
        """
        self._m[: self._size] = x

    def extend(self, cross: Array, own: Array) -> None:
        """Add n functionals, which no block held combines.

        Their column g of G gives that of Σ as (I - Σ M) g, and the mean as gᵀu.

        Args:
            cross: Prior covariance with those there are, shape (n, k).
            own: Among the new, shape (n, n).
        """
        k, n = self._size, len(own)
        weighted = _products(self._M, cross)
        between = cross - _products(self._S, weighted)
        corner = own - weighted @ between.T
        mean = cross @ self.sources
        self._grow(k + n)
        for whole, side, square in (
            (self._G, cross, own),
            (self._S, between, corner),
        ):
            whole[k : k + n, :k] = side
            whole[:k, k : k + n] = side.T
            whole[k : k + n, k : k + n] = 0.5 * (square + square.T)
        self._m[k : k + n] = mean

    def drop(self, slots: Slots) -> None:
        """Take out functionals which no block held combines.

        Args:
            slots: Their numbers, decreasing; the last one moves into each in turn.
        """
        for slot in slots:
            last = self._size - 1
            for vector in (self._h, self._m):
                vector[slot] = vector[last]
                vector[last] = 0.0
            for whole in (self._G, self._M, self._S):
                own = whole[last, last]
                whole[slot, : last + 1] = whole[last, : last + 1]
                whole[: last + 1, slot] = whole[: last + 1, last]
                whole[slot, slot] = own
                whole[last, : last + 1] = 0.0
                whole[: last + 1, last] = 0.0
            self._size = last

    def outlook(self, C: Combination) -> Outlook:
        """What a block of rows is expected to measure, and how surely; O(k)."""
        gain = _gathered(self._S, self._size, C.slots, C.values)
        spread = gain[:, C.slots] @ C.values
        mean = self._m[C.slots] @ C.values
        return Outlook(gain, np.eye(len(gain)) + 0.5 * (spread + spread.T), mean)

    def append(self, C: Combination, seen: Outlook, d: Array) -> None:
        """Take a block in; O(k²).

        Args:
            C: The rows.
            seen: Their `outlook` since the last change.
            d: Measured beyond p₀, shape (m,).
        """
        self._change(seen, seen.schur, d, 1.0)
        self.account(C, d, 1.0)
        self._s += float(d @ d)

    def remove(self, C: Combination, d: Array) -> None:
        """Take a block out; O(k²), or O(k³) where rounding would grow.

        Args:
            C: The rows.
            d: As it was given to `append`.
        """
        seen = self.outlook(C)
        left = 2.0 * np.eye(len(d)) - seen.schur
        self.forget(C, d)
        self._removals += 1
        sound = np.linalg.eigvalsh(left)[0] >= LEAST_LEFT
        if not sound or self._removals >= MOST_REMOVALS:
            self.refresh()
            return
        self._change(seen, left, d, -1.0)

    def forget(self, C: Combination, d: Array) -> None:
        """Take a block out of the sums only: `refresh` must follow."""
        self.account(C, d, -1.0)
        self._s -= float(d @ d)

    def account(self, C: Combination, d: Array, sign: float) -> None:
        """Add a block to M and h, or with sign -1 subtract it.

        A block written with other functionals of the same value leaves Σ and m alone.
        """
        _add_outer(self._M, C.slots, C.values, sign)
        np.add.at(self._h, C.slots, sign * (C.values @ d))

    def fade(self, factor: float) -> None:
        """Multiply the weight of all that is held, O(k³).

        Args:
            factor: Not negative [–].
        """
        k = self._size
        self._M[:k, :k] *= factor
        self._h[:k] *= factor
        self._s *= factor
        self.refresh()

    def clear(self) -> None:
        """Forget every block, to the last digit."""
        self._M[:] = 0.0
        self._h[:] = 0.0
        self._s = 0.0
        self.refresh()

    def refresh(self) -> None:
        """Make Σ and m from G, M and h; O(k³).

        Raises:
            NumericalError: I + G M is singular to rounding.
        """
        k = self._size
        self._removals = 0
        if k == 0:
            return
        G, M = self._G[:k, :k], self._M[:k, :k]
        if M.any():
            H = G @ M
            H[np.diag_indices(k)] += 1.0
            try:
                S = scipy.linalg.solve(H, G, overwrite_a=True)
            except (np.linalg.LinAlgError, scipy.linalg.LinAlgWarning) as error:
                raise NumericalError(
                    "the covariance cannot be made anew: the weights are too large"
                ) from error
            self._S[:k, :k] = 0.5 * (S + S.T)
        else:
            self._S[:k, :k] = G
        self._m[:k] = _products(self._S, self._h[None, :k])[0]

    def _change(self, seen: Outlook, spread: Array, d: Array, sign: float) -> None:
        """Σ and m when a block comes (sign 1) or goes (-1), with I ± C Σ Cᵀ."""
        inverse = np.linalg.inv(np.linalg.cholesky(spread))
        # einsum: too little work to wake a threaded BLAS for
        thin = np.einsum("ab,bk->ak", inverse, seen.gain)
        _add_squares(self._S, thin, -sign)
        self._m[: self._size] += sign * ((inverse @ (d - seen.mean)) @ thin)

    def _grow(self, size: int) -> None:
        """Make room for as many functionals, and note their number."""
        k, room = self._size, len(self._h)
        if size > room:
            # by a quarter: twice as many would be four times the memory
            room = max(room + room // 4, size)
            # one after the other: only one of them is there twice
            self._G = _enlarged(self._G, k, room)
            self._M = _enlarged(self._M, k, room)
            self._S = _enlarged(self._S, k, room)
            self._h = np.concatenate([self._h, np.zeros(room - len(self._h))])
            self._m = np.concatenate([self._m, np.zeros(room - len(self._m))])
        self._size = size


def warm_up(height: int) -> None:
    """Compile, so that no update has to.

    Args:
        height: Rows per block [–].
    """
    posterior = Posterior()
    posterior.extend(np.zeros((1, 0)), np.eye(1))
    C = Combination(np.zeros(1, dtype=np.int64), np.zeros((1, height)))
    posterior.append(C, posterior.outlook(C), np.zeros(height))
    posterior.step(posterior.sources, posterior.mean)


def _enlarged(old: Array, k: int, room: int) -> Array:
    """A larger array with the same upper left part."""
    out = np.zeros((room, room))
    out[:k, :k] = old[:k, :k]
    return out


# Loops instead of BLAS: its threads stall each other when another process holds a
# core, and for so little work waking them takes longer than the work.


def _products(whole: Array, rows: Array) -> Array:
    """Symmetric matrix times several vectors.

    Args:
        whole: Array whose upper left part is the matrix, (room, room).
        rows: The vectors, shape (n, k).

    Returns:
        One product per row, shape (n, k).
    """
    out = np.empty(rows.shape)
    _multiply(whole, np.ascontiguousarray(rows), out)
    return out


@compiled(nogil=True, fastmath={"reassoc", "contract"})
def _multiply(whole: Array, rows: Array, out: Array) -> None:
    """One product per row (compiled)."""
    n, k = rows.shape
    for i in range(k):
        line = whole[i, :k]
        for a in range(n):
            x = rows[a]
            total = 0.0
            for j in range(k):
                total += line[j] * x[j]
            out[a, i] = total


@compiled(nogil=True, fastmath={"contract"})
def _gathered(whole: Array, k: int, slots: Slots, values: Array) -> Array:
    """C Σ for a sparse C, shape (m, k) (compiled)."""
    out = np.zeros((values.shape[1], k))
    for e in range(len(slots)):
        line = whole[slots[e], :k]
        for c in range(values.shape[1]):
            value, sums = values[e, c], out[c]
            for j in range(k):
                sums[j] += value * line[j]
    return out


@compiled(nogil=True, fastmath={"contract"})
def _add_squares(whole: Array, thin: Array, sign: float) -> None:
    """Add sign · thinᵀ thin, both triangles alike to the last bit (compiled)."""
    m, k = thin.shape
    for i in range(k):
        line = whole[i, :k]
        for c in range(m):
            value, other = sign * thin[c, i], thin[c]
            for j in range(k):
                line[j] += value * other[j]


@compiled(nogil=True)
def _add_outer(whole: Array, slots: Slots, values: Array, sign: float) -> None:
    """Add sign · CᵀC for a sparse C (compiled)."""
    m = values.shape[1]
    for e in range(len(slots)):
        line = whole[slots[e]]
        for f in range(len(slots)):
            total = 0.0
            for c in range(m):
                total += values[e, c] * values[f, c]
            line[slots[f]] += sign * total

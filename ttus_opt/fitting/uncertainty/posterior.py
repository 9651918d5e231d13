"""The error of a field fitted to measured rows, of any prior.

With the prior p ~ N(p̄, C) and weighted rows D the estimate is p̄ + C Dᵀ S⁻¹d, S = 1 +
D C Dᵀ (`gaussian.conditioned`). If the true covariances are v C of the prior and Σ of
the rows' noise, its error has, with X = N C Dᵀ and Q = X S⁻¹, the covariance

    Cov[N p] = v (N C Nᵀ − Q Xᵀ − Q Qᵀ) + Q Σ Qᵀ.

A draw is a draw of the prior minus its estimate from its own noisy measurements
(Matheron's rule: A. G. Journel, C. J. Huijbregts, Mining Geostatistics, 1978). Contact
samples only voxels near the skin: draws are kept down to some depth, and the covariance
of rows is then the sample covariance over them. See docs/method/identification.md,
Uncertainty.
"""

from __future__ import annotations

import abc
import math
from dataclasses import dataclass, field, replace
from typing import Self

import numpy as np
import scipy.sparse as sp
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.uncertainty.wrench_noise import ErrorModel
from ttus_opt.gaussian.conditioned import Conditioned
from ttus_opt.gaussian.prior import Prior
from ttus_opt.voxmap.sampling import spoke_table
from ttus_opt.voxmap.voxmap import Voxmap

Float32Array = NDArray[np.float32]

#: Rows, and draws, that are corrected by all measurements at once: a pass over what
#: these are stored as costs more than the sums
ROWS_AT_ONCE, DRAWS_AT_ONCE = 192, 32

#: Errors before any are known, of no rows
UNKNOWN = ErrorModel(1.0, sp.csr_array((0, 0)))

#: No draws are kept deeper than this [m]
DEEPEST = 1.0


@dataclass(frozen=True)
class Posterior(abc.ABC):
    """The error of a fit, given the errors of its prior and its measurements.

    Attributes:
        prior: C.
        informative: Rows of the problem that depend on the field, shape (m,).
        rows: D, these rows times the square roots of their weights, shape (rows, V).
        images: B with BᵀB = D C Dᵀ, shape (k, rows).
        measured: Their measurements.
        errors: Prior variance and noise of the rows.
    """

    prior: Prior = field(repr=False)
    informative: Mask = field(repr=False)
    rows: sp.csr_array = field(repr=False)
    images: Array = field(repr=False)
    measured: Conditioned = field(repr=False)
    errors: ErrorModel = field(default=UNKNOWN, repr=False, kw_only=True)

    def with_errors(self, errors: ErrorModel) -> Self:
        """The same with known errors of prior and measurements."""
        return replace(self, errors=errors)

    def covariance(
        self, rows: sp.csr_array, height: int, sized: Array | None = None
    ) -> Array:
        """Covariance of blocks of rows of the field, (k, height, height).

        NaN where a block touches voxels at which nothing is stored.

        Args:
            rows: Shape (k · height, V).
            height: Rows of a block [–].
            sized: Their change per ln ℓ₀ of `contact-size`, shape (k · height,); None
                for 0.
        """
        sized = np.zeros(rows.shape[0]) if sized is None else sized
        filled = np.asarray(np.diff(rows.indptr).reshape(-1, height).any(axis=1))
        out = np.zeros((len(filled), height, height))
        (blocks,) = np.nonzero(filled)
        few = sp.csr_array(rows[_rows_of(blocks, height)])
        out[blocks] = self.errors.variance * self.prior.among_rows(few, height)
        step = max(ROWS_AT_ONCE // height, 1)
        for some in (blocks[i : i + step] for i in range(0, len(blocks), step)):
            at = _rows_of(some, height)
            out[some] += self._gained(sp.csr_array(rows[at]), height, sized[at])
        return out

    @abc.abstractmethod
    def _gained(self, rows: sp.csr_array, height: int, sized: Array) -> Array:
        """Blocks of Q Σ Qᵀ − v (Q Xᵀ + Q Qᵀ), (k, height, height); NaN as above."""

    def draw(
        self, count: int, voxels: IntArray | None = None
    ) -> tuple[Float32Array, Array]:
        """Draws of the error, (count, n), and of ln ℓ₀ of `contact-size`, (count,).

        Args:
            count: Number of draws [–].
            voxels: Voxels of the draws, shape (n,); None for all.
        """
        rng, at = np.random.default_rng(0), slice(None) if voxels is None else voxels
        n = self.rows.shape[1] if voxels is None else len(voxels)
        out = np.empty((count, n), dtype=np.float32)
        samples, sizes = np.empty((count, self.rows.shape[0])), np.zeros(count)
        for k in range(count):
            p, samples[k], sizes[k] = self._drawn(rng)
            out[k] = p[at]
        for first in range(0, count, DRAWS_AT_ONCE):
            some = slice(first, first + DRAWS_AT_ONCE)
            out[some] -= self._estimate(samples[some], voxels)
        return out, sizes

    @abc.abstractmethod
    def _drawn(self, rng: np.random.Generator) -> tuple[Array, Array, float]:
        """A draw of the prior, (V,), its noisy measurements, (rows,), and ln ℓ₀."""

    @abc.abstractmethod
    def _estimate(self, samples: Array, voxels: IntArray | None) -> Array:
        """C Dᵀ S⁻¹ samples at some voxels, of shape (k, rows), shape (k, n)."""


def _rows_of(blocks: IntArray, height: int) -> IntArray:
    return (blocks[:, None] * height + np.arange(height)).ravel()


def kept_rows(
    rows: sp.csr_array, voxels: IntArray, height: int
) -> tuple[sp.csr_array, Mask]:
    """Rows of a field over some voxels only.

    Args:
        rows: Rows of a field, shape (k · height, V).
        voxels: The voxels, shape (n,).
        height: Rows of a block [–].

    Returns:
        The rows over these voxels, (k · height, n), and which blocks touch others,
        (k,).
    """
    place = np.full(rows.shape[1], -1, dtype=np.int64)
    place[voxels] = np.arange(len(voxels))
    column = place[rows.indices]
    missing = np.zeros(rows.shape[0] // height, dtype=bool)
    block = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr)) // height
    missing[block[column < 0]] = True
    few = (rows.shape[0], len(voxels))
    kept = sp.csr_array((rows.data, np.maximum(column, 0), rows.indptr), few)
    return kept, missing


@dataclass(frozen=True)
class PosteriorDraws:
    """Draws of the error of a field.

    Attributes:
        values: The draws, shape (count, n) [unit of the field].
        sizes: Draws of ln ℓ₀ of `contact-size`, shape (count,) [–].
        voxels: Voxels of the field's, shape (n,), ascending.
        depth: Depth below the skin down to which they are kept [m].
    """

    values: Float32Array = field(repr=False)
    sizes: Array = field(repr=False)
    voxels: IntArray = field(repr=False)
    depth: float

    def covariance(
        self, rows: sp.csr_array, height: int, sized: Array | None = None
    ) -> Array:
        """Covariance of blocks of rows of a field.

        Args:
            rows: Shape (k · height, V).
            height: Rows of a block [–].
            sized: As of `Posterior.covariance`.

        Returns:
            Shape (k, height, height); NaN where a block touches other voxels.
        """
        near, missing = kept_rows(rows, self.voxels, height)
        count = len(self.values)
        out = np.zeros((rows.shape[0] // height, height, height))
        for start in range(0, count, DRAWS_AT_ONCE):  # only these in double precision
            these = slice(start, start + DRAWS_AT_ONCE)
            samples = np.asarray(near @ self.values[these].T)
            if sized is not None:
                samples += np.outer(sized, self.sizes[these])
            samples = samples.reshape(len(out), height, -1)
            out += samples @ samples.transpose(0, 2, 1) / count
        out[missing] = np.nan
        return np.asarray(out)


def skin_voxels(voxmap: Voxmap, depth: float) -> IntArray:
    """Voxels that contact down to some depth samples, shape (n,), ascending.

    Args:
        voxmap: Grid and surface.
        depth: Depth below the surface [m].

    Raises:
        InputError: As in `checked_depth`.
    """
    checked_depth(depth)
    grid = voxmap.grid
    outermost = spoke_table(voxmap)[:, 1].astype(np.int64)
    n_spokes = len(outermost)
    layers = outermost - np.arange(math.ceil(depth / grid.r_step) + 2)[:, None]
    spokes = np.broadcast_to(np.arange(n_spokes), layers.shape)
    inside = layers >= 0
    return np.sort(layers[inside] * n_spokes + spokes[inside])


def checked_depth(depth: float) -> float:
    """Return a valid depth [m].

    Raises:
        InputError: It is not positive, or beyond `DEEPEST`.
    """
    if not 0.0 < depth < DEEPEST:
        raise InputError(
            f"depth must be positive and below {DEEPEST:g} m, got {depth} m"
        )
    return depth

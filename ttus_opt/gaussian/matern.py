"""Gaussian fields on the voxel grid with a Matérn covariance, and its sparse factor.

A Matérn field solves (κ² − Δ) g = white noise. Finite volumes on the surface and finite
differences along the depth each give a sparse matrix R with precision RᵀR. The product
of both covariances is separable, so its entries at the few voxels that measurements
touch need no solve over all voxels.

Source: F. Lindgren, H. Rue, J. Lindström, An explicit link between Gaussian fields and
Gaussian Markov random fields, J. R. Stat. Soc. B 73 (2011). See
docs/method/formulations.md, Depth map.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import scipy.sparse.linalg

from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.gaussian.prior import Prior
from ttus_opt.voxmap.voxmap import Voxmap

#: Columns of the surface's covariance computed at once
AT_ONCE = 256

#: Entries of the columns solved for at once by one thread, which the cache holds: of
#: 28,800 nodes a column takes 0.7 ms, with more at once or more threads of a BLAS 2 to
#: 40 ms [–]
ENTRIES = 460_800

#: Eigenvalue below which, relative to the largest, a radial mode is rounding [–]
LEAST_EIGENVALUE = 1e-10


def matern(distance: Array, length: float) -> Array:
    """Matérn 3/2, (1 + √3 d/ℓ) exp(−√3 d/ℓ), of distances of any shape."""
    scaled = np.sqrt(3.0) / length * distance
    return np.asarray((1.0 + scaled) * np.exp(-scaled))


@dataclass(frozen=True)
class MaternFactor:
    """R = τ C^-½ (κ² C + G), which maps a field of unit variance to white noise.

    Attributes:
        volumes: C, length or area of each node, shape (n,) [m or m²].
        stiffness: G, stiffness matrix of −Δ with zero flux at the rim, (n, n).
        kappa: κ [1/m].
        tau: τ, for variance 1 far from the rim.
    """

    volumes: Array = field(repr=False)
    stiffness: sp.csc_array = field(repr=False)
    kappa: float
    tau: float

    @classmethod
    def along_line(cls, n: int, step: float, length: float) -> MaternFactor:
        """Matérn 3/2, (1 + √3 d/ℓ) exp(−√3 d/ℓ), on equal steps.

        Args:
            n: Number of nodes [–].
            step: Distance between them [m].
            length: ℓ [m].
        """
        volumes = np.full(n, step)
        volumes[[0, -1]] /= 2.0
        links = np.full(n - 1, 1.0 / step)
        kappa = np.sqrt(3.0) / length
        stiffness = _stiffness(np.arange(n - 1), np.arange(1, n), links, n)
        return cls(volumes, stiffness, kappa, 1.0 / np.sqrt(4.0 * kappa**3))

    @classmethod
    def on_surface(
        cls,
        points: Array,
        length: float,
        *,
        ratio: float = 1.0,
        is_open: bool = False,
    ) -> MaternFactor:
        """Matérn 1, (κd) K₁(κd), on a tube of quadrilaterals.

        Its range √8/κ is that of a Matérn 3/2 of the length ℓ: κ = √2/ℓ. Different
        lengths around and along are one length on a tube stretched at constant area.

        Args:
            points: Nodes around (periodic) and along, shape (n_theta, n_z, 3) [m].
            length: ℓ, the geometric mean of both lengths [m].
            ratio: Length around over length along [–].
            is_open: Whether the tube is cut open along its last line of nodes, which is
                then uncorrelated with its neighbours.
        """
        n_theta, n_z, _ = points.shape
        around = np.linalg.norm(np.roll(points, -1, 0) - points, axis=-1)
        if is_open:
            around[-1] = around[0]  # equal distances on both sides of the wall
        around /= np.sqrt(ratio)
        along = np.sqrt(ratio) * np.linalg.norm(np.diff(points, axis=1), axis=-1)
        width = (around + np.roll(around, 1, 0)) / 2.0  # of a node, around
        padded = np.pad(along, ((0, 0), (1, 1)))
        height = (padded[:, 1:] + padded[:, :-1]) / 2.0  # of a node, along
        node = np.arange(n_theta * n_z).reshape(n_theta, n_z)
        heads = np.concatenate([node.ravel(), node[:, :-1].ravel()])
        tails = np.concatenate([np.roll(node, -1, 0).ravel(), node[:, 1:].ravel()])
        across_around = (height + np.roll(height, -1, 0)) / 2.0 / around
        if is_open:
            across_around[-2:] = 0.0
        across_along = (width[:, :-1] + width[:, 1:]) / 2.0 / along
        links = np.concatenate([across_around.ravel(), across_along.ravel()])
        kappa = np.sqrt(2.0) / length
        return cls(
            (width * height).ravel(),
            _stiffness(heads, tails, links, node.size),
            kappa,
            1.0 / np.sqrt(4.0 * np.pi * kappa**2),
        )

    @cached_property
    def operator(self) -> sp.csc_array:
        """κ² C + G, symmetric positive definite."""
        return sp.csc_array(
            self.stiffness + sp.diags_array(self.kappa**2 * self.volumes)
        )

    @property
    def rows(self) -> sp.csr_array:
        """R, (n, n)."""
        return sp.csr_array(
            sp.diags_array(self.tau / np.sqrt(self.volumes)) @ self.operator
        )

    @cached_property
    def _solved(self) -> scipy.sparse.linalg.SuperLU:
        return scipy.sparse.linalg.splu(self.operator, permc_spec="MMD_AT_PLUS_A")

    def __reduce__(self) -> tuple[type[MaternFactor], tuple[object, ...]]:
        """Pickle without the factorisation, which has no other form."""
        return MaternFactor, (self.volumes, self.stiffness, self.kappa, self.tau)

    def covariance(self, nodes: IntArray) -> Array:
        """Columns of (RᵀR)⁻¹, shape (n, k)."""
        unit = np.zeros((len(self.volumes), len(nodes)))
        unit[nodes, np.arange(len(nodes))] = 1.0
        return self.covariance_times(unit)

    def covariance_times(self, values: Array) -> Array:
        """(RᵀR)⁻¹ values, shape (n, k)."""
        out = np.empty(values.shape)
        with one_blas_thread():
            for some in _few_columns(values):
                inner = self.volumes[:, None] * self._solved.solve(values[:, some])
                out[:, some] = self._solved.solve(inner)
        return out / self.tau**2

    def draw(self, white: Array) -> Array:
        """Fields R⁻¹ w from white noise w, shape (n, k)."""
        out, root = np.empty(white.shape), np.sqrt(self.volumes)[:, None] / self.tau
        with one_blas_thread():
            for some in _few_columns(white):
                out[:, some] = self._solved.solve(root * white[:, some])
        return out


@dataclass(frozen=True)
class SeparableCovariance(Prior):
    """Covariance of s_v g_v over voxels, with g separable in depth and spoke.

    Every spoke is turned by whole layers, so that the skin lies in the same one: places
    at the same depth are alike, not those at the same radius. What lies outside the
    skin comes last, below the innermost layer, where nothing is measured.

    Attributes:
        radial: Factor over the layers, n_r nodes.
        surface: Factor over the spokes, n_θ n_z nodes.
        scale: s, shape (V,).
        turned: Number of every voxel when spokes are turned, shape (V,).
    """

    radial: MaternFactor
    surface: MaternFactor
    scale: Array = field(repr=False)
    turned: IntArray = field(repr=False)

    @classmethod
    def over(
        cls,
        voxmap: Voxmap,
        scale: Array,
        surface_length: float,
        depth_length: float,
        length_ratio: float = 1.0,
    ) -> SeparableCovariance:
        """The covariance on the voxels of a voxmap.

        Args:
            voxmap: Grid and surface.
            scale: s, shape (V,) [unit of p].
            surface_length: Matérn length along the surface [m].
            depth_length: Matérn length along the depth [m].
            length_ratio: Length around the patient over length along it; surface_length
                is their geometric mean [–].
        """
        grid = voxmap.grid
        theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
        radius = voxmap.spoke_radius
        points = np.stack([radius * np.cos(theta), radius * np.sin(theta), z], axis=-1)
        n_r, n_spokes = grid.shape[0], theta.size
        skin = np.rint(voxmap.surface_place).astype(np.int64).ravel()
        layer = (np.arange(n_r)[:, None] - skin - 1) % n_r
        turned = (layer * n_spokes + np.arange(n_spokes)).ravel()
        return cls(
            MaternFactor.along_line(grid.shape[0], grid.r_step, depth_length),
            MaternFactor.on_surface(
                points,
                surface_length,
                ratio=length_ratio,
                is_open=grid.wall is not None,
            ),
            scale,
            turned,
        )

    @property
    def rows(self) -> sp.csr_array:
        """Square R with (RᵀR)⁻¹ the covariance, shape (V, V)."""
        both = kronecker(self.radial.rows, self.surface.rows)
        voxel = np.argsort(self.turned).astype(both.indices.dtype)
        columns = voxel[both.indices]
        data = both.data / self.scale[columns]
        return sp.csr_array((data, columns, both.indptr), shape=both.shape)

    def columns(self, voxels: IntArray) -> VoxelColumns:
        """Its columns at some voxels, in factored form."""
        n_spokes = len(self.surface.volumes)
        layers, layer = np.unique(self.layers(voxels), return_inverse=True)
        spokes, spoke = np.unique(voxels % n_spokes, return_inverse=True)
        radial, surface = (
            self.radial.covariance(layers),
            self.surface.covariance(spokes),
        )
        own = self.scale[voxels]
        parts = radial[layers], surface[spokes]
        return VoxelColumns(self, voxels, radial, surface, layer, spoke, own, parts)

    def layers(self, voxels: IntArray) -> IntArray:
        """Layers of voxels when spokes are turned."""
        return self.turned[voxels] // len(self.surface.volumes)

    def times(self, values: Array) -> Array:
        """Implements `Prior`."""
        shape = (len(self.radial.volumes), len(self.surface.volumes))
        g = np.empty(len(values))
        g[self.turned] = self.scale * values
        g = self.surface.covariance_times(g.reshape(shape).T).T
        g = self.radial.covariance_times(g).ravel()
        return np.asarray(self.scale * g[self.turned])

    def draw(self, rng: np.random.Generator) -> Array:
        """Implements `Prior`."""
        shape = (len(self.radial.volumes), len(self.surface.volumes))
        g = self.surface.draw(rng.standard_normal(shape).T).T
        return np.asarray(self.scale * self.radial.draw(g).ravel()[self.turned])

    def among_rows(self, rows: sp.csr_array, height: int) -> Array:
        """Implements `Prior`."""
        if rows.shape[0] == height:  # a block of many poses touches too many voxels
            return self._among_all(rows)[None]
        n_spokes = len(self.surface.volumes)
        of_entry = rows.indices.astype(np.int64) % n_spokes
        spokes, spoke = np.unique(of_entry, return_inverse=True)
        between = np.empty((len(spokes), len(spokes)))
        for first in range(0, len(spokes), AT_ONCE):
            own = spokes[first : first + AT_ONCE]
            between[:, first : first + AT_ONCE] = self.surface.covariance(own)[spokes]
        radial = self.radial.covariance(np.arange(len(self.radial.volumes)))
        out = np.zeros((rows.shape[0] // height, height, height))
        for k in range(len(out)):
            part = slice(rows.indptr[k * height], rows.indptr[(k + 1) * height])
            voxels, at, column = np.unique(
                rows.indices[part], return_index=True, return_inverse=True
            )
            ends = rows.indptr[k * height : (k + 1) * height + 1] - part.start
            scaled = rows.data[part] * self.scale[rows.indices[part]]
            own_rows = sp.csr_array((scaled, column, ends), (height, len(voxels)))
            place, layer = spoke[part][at], self.layers(voxels.astype(np.int64))
            cov = between[np.ix_(place, place)] * radial[np.ix_(layer, layer)]
            out[k] = own_rows @ (own_rows @ cov).T
        return out

    def _among_all(self, rows: sp.csr_array) -> Array:
        """The same of all rows, a mode of the radial part at a time."""
        n_spokes, k = len(self.surface.volumes), rows.shape[0]
        touched = rows.indices.astype(np.int64)
        layers, layer = np.unique(self.layers(touched), return_inverse=True)
        values, modes = np.linalg.eigh(self.radial.covariance(layers)[layers])
        out = np.zeros((k, k))
        for value, mode in zip(values, modes.T, strict=True):
            if value > LEAST_EIGENVALUE * values.max():
                data = rows.data * self.scale[touched] * mode[layer]
                parts = (data, touched % n_spokes, rows.indptr)
                own = sp.csr_array(parts, (k, n_spokes))
                out += value * (own @ self.surface.covariance_times(own.T.toarray()))
        return out


@dataclass(frozen=True)
class VoxelColumns:
    """Columns of a separable covariance at n voxels.

    Attributes:
        covariance: The covariance.
        voxels: Shape (n,).
        radial: Columns of the radial part at the layers that occur, (n_r, k_r).
        surface: Columns of the surface part at the spokes that occur, (n_s, k_s).
        layer: Which of those layers, shape (n,).
        spoke: Which of those spokes, shape (n,).
        scale: s of the voxels, shape (n,).
        parts: The covariance among those layers, and among those spokes.
    """

    covariance: SeparableCovariance = field(repr=False)
    voxels: IntArray
    radial: Array = field(repr=False)
    surface: Array = field(repr=False)
    layer: IntArray = field(repr=False)
    spoke: IntArray = field(repr=False)
    scale: Array = field(repr=False)
    parts: tuple[Array, Array] = field(repr=False)

    @property
    def among(self) -> Array:
        """The covariance between the voxels, shape (n, n)."""
        return self.among_some(np.arange(len(self.voxels)))

    def among_some(self, some: IntArray) -> Array:
        """Columns of the same, shape (n, k)."""
        radial, surface = self.parts
        cov = radial[np.ix_(self.layer, self.layer[some])]
        cov *= surface[np.ix_(self.spoke, self.spoke[some])]
        cov *= self.scale[:, None] * self.scale[some]
        return cov

    @property
    def variance(self) -> Array:
        """Its diagonal, shape (n,)."""
        radial, surface = (np.diag(part) for part in self.parts)
        return self.scale**2 * radial[self.layer] * surface[self.spoke]

    def among_times(self, values: Array) -> Array:
        """The same times values of shape (n,), from its parts."""
        radial, surface = self.parts
        g = radial @ self._spread(values) @ surface
        return np.asarray(self.scale * g[self.layer, self.spoke])

    def _spread(self, values: Array) -> Array:
        """Scaled values on the layers and spokes that occur, shape (k_r, k_s)."""
        w = np.zeros((self.radial.shape[1], self.surface.shape[1]))
        np.add.at(w, (self.layer, self.spoke), self.scale * values)
        return w

    def of_rows(self, rows: sp.csr_array) -> Array:
        """Rows of a field, shape (k, V), times the columns, shape (k, n)."""
        touched = rows.indices.astype(np.int64)
        layers, layer = np.unique(self.covariance.layers(touched), return_inverse=True)
        row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
        at = row * len(layers) + layer, touched % len(self.surface)
        parts = rows.data * self.covariance.scale[touched], at
        by_layer = sp.csr_array(
            parts, shape=(rows.shape[0] * len(layers), len(self.surface))
        )
        g = np.asarray(by_layer @ self.surface)
        g = self.radial[layers].T @ g.reshape(rows.shape[0], len(layers), -1)
        return np.asarray(self.scale * g[:, self.layer, self.spoke])

    def times(self, values: Array) -> Array:
        """The columns times values of shape (n,), shape (V,)."""
        g = (self.radial @ (self._spread(values) @ self.surface.T)).ravel()
        return np.asarray(self.covariance.scale * g[self.covariance.turned])


def _few_columns(values: Array) -> Iterator[slice]:
    """As many columns at once as are solved for at once."""
    step = max(ENTRIES // len(values), 1)
    for first in range(0, values.shape[1], step):
        yield slice(first, first + step)


def kronecker(left: sp.csr_array, right: sp.csr_array) -> sp.csr_array:
    """Kronecker product, row by row: SciPy's ``kron`` in a fifth of its time.

    Args:
        left: Few rows, shape (m, n).
        right: Shape (k, l).
    """
    (m, n), (k, width) = left.shape, right.shape
    index = sp.get_index_dtype(maxval=max(n * width, left.nnz * right.nnz))
    counts, lengths = np.diff(left.indptr), np.diff(right.indptr)
    starts = np.concatenate([[0], np.cumsum(np.outer(counts, lengths))]).astype(index)
    data, columns = np.empty(starts[-1]), np.empty(starts[-1], index)
    before = np.repeat(right.indptr[:-1], lengths)
    within, length = np.arange(right.nnz) - before, np.repeat(lengths, lengths)
    own = right.indices.astype(index)
    for i in range(m):
        first, count = int(starts[i * k]), int(counts[i])
        entries = slice(left.indptr[i], left.indptr[i + 1])
        for at, (value, j) in enumerate(
            zip(left.data[entries], left.indices[entries], strict=True)
        ):
            places = first + count * before + at * length + within
            data[places] = value * right.data
            columns[places] = j * width + own
    return sp.csr_array((data, columns, starts), shape=(m * k, n * width))


def _stiffness(heads: IntArray, tails: IntArray, links: Array, n: int) -> sp.csc_array:
    """Graph Laplacian of weighted links."""
    i, j = np.concatenate([heads, tails]), np.concatenate([tails, heads])
    w = np.concatenate([links, links])
    off = sp.csc_array((w, (i, j)), shape=(n, n))
    return sp.csc_array(sp.diags_array(np.asarray(off.sum(axis=1)).ravel()) - off)

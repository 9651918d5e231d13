"""L and b by Kronecker products of scipy: what the compiled assembly is judged by.

N and W are judged by whole-array numpy (`ttus_opt.benchmark.parts.rendering`).
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve


def plain_laplace(voxmap, inner, outer):
    """L and b of paper eq. 8.

    Args:
        voxmap: Grid and regions.
        inner: p_in.
        outer: p_out; the outer layer has minus that.

    Returns:
        L, shape (V, V), and b, shape (V,).
    """
    grid = voxmap.grid
    n_r, n_theta, n_z = grid.shape
    half = grid.r_step / (2.0 * grid.r)
    around = sp.diags_array((grid.r_step / (grid.r * grid.theta_step)) ** 2)
    radial = (
        sp.diags_array((1.0 - half)[1:], offsets=-1)
        + sp.diags_array(np.full(n_r, -2.0))
        + sp.diags_array((1.0 + half)[:-1], offsets=1)
    )
    ring = sp.diags_array(
        [1.0, 1.0, -2.0, 1.0, 1.0],
        offsets=[1 - n_theta, -1, 0, 1, n_theta - 1],
        shape=(n_theta, n_theta),
    )
    chain = sp.diags_array([1.0, -2.0, 1.0], offsets=[-1, 0, 1], shape=(n_z, n_z))
    slices = sp.csr_array(
        sp.kron(radial, sp.eye_array(n_theta)) + sp.kron(around, ring)
    )
    along = (grid.r_step / grid.z_step) ** 2 * chain
    full = sp.csr_array(
        sp.kron(slices, sp.eye_array(n_z)) + sp.kron(sp.eye_array(n_r * n_theta), along)
    )
    b = np.zeros(grid.shape)
    b[0], b[-1] = inner, -outer
    for k in (0, -1):
        skin = voxmap.on_surface[:, :, k]
        edge = skin.copy()
        edge[[0, -1]] = True
        side = np.where(skin, 0.0, b[:, :, k] * edge).reshape(-1)
        M = _with_ghosts(slices, voxmap, (slice(None), slice(None), k))
        polar = spsolve(sp.csc_array(_with_identity(M, edge.reshape(-1))), side)
        b[:, :, k] = polar.reshape(n_r, n_theta)
    b[voxmap.on_surface] = 0.0
    full = _with_ghosts(full, voxmap, (slice(None),) * 3)
    return _with_identity(full, voxmap.dirichlet.reshape(-1)), b.reshape(-1)


def _with_ghosts(M, voxmap, part):
    """The matrix where b of the surface layer has p_a φ_b/φ_a + s (1 − φ_b/φ_a).

    φ is the depth below the surface, s what the layer holds; not in a staircase.
    """
    if voxmap.boundary == "staircase":
        return M
    grid = voxmap.grid
    radius = voxmap.surface.radius_at(grid.theta[:, None], grid.z)
    depth = (radius[None] - grid.r[:, None, None])[part].reshape(-1)
    layer = voxmap.on_surface[part].reshape(-1)
    entries = sp.coo_array(M)
    a, b = entries.coords
    kept = entries.data != 0.0
    a, b, w = a[kept], b[kept], entries.data[kept]
    to_layer = layer[b] & ~layer[a]
    ratio = depth[b] / np.where(to_layer, depth[a], np.inf)
    own = np.where(to_layer, np.minimum(ratio, 1.0), 0.0)
    rows, columns = np.concatenate([a, a]), np.concatenate([b, a])
    values = np.concatenate([w * (1.0 - own), w * own])
    return sp.csr_array(sp.coo_array((values, (rows, columns)), shape=M.shape))


def _with_identity(M, fixed):
    """The matrix with identity rows where a value is given."""
    keep = sp.diags_array((~fixed).astype(float))
    return sp.csr_array(keep @ M + sp.diags_array(fixed.astype(float)))

"""L, b, N and W written straightforwardly: what the compiled assembly is judged by.

`plain_laplace` is Kronecker products of scipy, `plain_rows` whole-array numpy pose by
pose.
"""

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import spsolve

from ttus_opt.benchmark.parts.rendering import plain_samples
from ttus_opt.contact.rows import REFERENCE_AREA


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


def plain_rows(voxmap, shell, rotation, position, sampling):
    """N and W of paper eqs. 6 and 7.

    Args:
        voxmap: Grid and surface.
        shell: The probe.
        rotation: Probe to patient, shape (T, 3, 3) [–].
        position: Of the probe frame's origin, shape (T, 3) [m].
        sampling: ``voxel-mean`` or ``trilinear``.

    Returns:
        N and W, shape (3T, V) each.
    """
    rows, columns, force, torque = [], [], [], []
    for t, (R, at) in enumerate(zip(rotation, position, strict=True)):
        points = shell.points @ R.T + at
        inside, voxel, share = plain_samples(voxmap, points, sampling)
        if sampling == "trilinear":
            share = share * (shell.areas[inside] / REFERENCE_AREA)[:, None]
        normals = shell.normals[inside] @ R.T
        moments = np.cross((shell.points[inside] - shell.reference) @ R.T, normals)
        for axis in range(3):
            rows.append(np.full(voxel.size, 3 * t + axis))
            columns.append(voxel.reshape(-1))
            force.append((share * normals[:, axis, None]).reshape(-1))
            torque.append((share * moments[:, axis, None]).reshape(-1))
    shape = (3 * len(position), voxmap.grid.n_voxels)
    at_entries = (np.concatenate(rows), np.concatenate(columns))
    # a voxel that several points sample is summed when the rows are compressed
    return (
        sp.csr_array(sp.coo_array((np.concatenate(force), at_entries), shape=shape)),
        sp.csr_array(sp.coo_array((np.concatenate(torque), at_entries), shape=shape)),
    )

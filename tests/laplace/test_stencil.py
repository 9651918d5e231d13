"""Rows of L and b against the stencil written down voxel by voxel."""

import itertools
from dataclasses import fields

import numpy as np
import pytest
import scipy.sparse as sp

from tests.kit import torso
from ttus_opt.laplace.multigrid.coarsening import conductances
from ttus_opt.laplace.stencil import VariantGrid
from ttus_opt.laplace.system import LaplaceSystem
from ttus_opt.voxmap.grid import CylindricalGrid
from ttus_opt.voxmap.voxmap import SURFACE, Voxmap


def ghost(voxmap, a, b):
    """What voxel b of the surface layer has of the value of its neighbour a.

    Linear between a and the surface, and beyond (docs/method/contact.md, eq. 4.10); a
    value s on the surface has the rest.
    """
    if voxmap.boundary == "staircase" or voxmap.region[b] != SURFACE:
        return 0.0
    grid = voxmap.grid
    depths = [
        float(voxmap.surface.radius_at(grid.theta[j], grid.z[k])) - grid.r[i]
        for i, j, k in (a, b)
    ]
    return min(depths[1] / depths[0], 1.0)


def reference_rows(voxmap):
    """The stencil (docs/method/contact.md, eq. 4.2) written down voxel by voxel."""
    grid = voxmap.grid
    n_r, n_theta, n_z = grid.shape
    at = np.arange(grid.n_voxels).reshape(grid.shape)
    L = sp.lil_array((grid.n_voxels, grid.n_voxels))
    step = grid.r_step
    for i, j, k in itertools.product(range(n_r), range(n_theta), range(n_z)):
        row = at[i, j, k]
        if voxmap.dirichlet[i, j, k]:
            L[row, row] = 1.0
            continue
        r = grid.r[i]
        neighbours = (
            [((i + d, j, k), 1.0 + d * step / (2 * r)) for d in (1, -1)]
            + [
                ((i, (j + d) % n_theta, k), (step / (r * grid.theta_step)) ** 2)
                for d in (1, -1)
            ]
            + [((i, j, k + d), (step / grid.z_step) ** 2) for d in (1, -1)]
        )
        for there, weight in neighbours:
            own = ghost(voxmap, (i, j, k), there)
            L[row, at[there]] += weight * (1.0 - own)
            L[row, row] += weight * (own - 1.0)
    return sp.csr_array(L)


@pytest.mark.parametrize("boundary", ["subvoxel", "staircase"])
@pytest.mark.parametrize("shape", [(9, 12, 7), (8, 5, 4), (12, 4, 3)])
def test_rows_equal_the_plain_reference(shape, boundary):
    voxmap = Voxmap.from_surface(torso(), shape=shape, boundary=boundary)
    system = LaplaceSystem.assemble(voxmap)
    difference = system.L - reference_rows(system.voxmap)
    assert abs(difference).max() < 1e-12
    for row in range(system.L.shape[0]):  # columns ascend within each row
        columns = system.L.indices[system.L.indptr[row] : system.L.indptr[row + 1]]
        assert (np.diff(columns) > 0).all()


def between():
    """A torso whose surface lies between the layers."""
    return LaplaceSystem.assemble(Voxmap.from_surface(torso(), shape=(14, 24, 11)))


def touching():
    """A torso whose surface reaches the outer layer at its widest, ends as well."""
    surface = torso()
    widest = float(surface.radius.max())
    voxmap = Voxmap.from_surface(surface, shape=(14, 24, 11), r_outer=widest)
    at_end = voxmap.region[-1, :, 0] == SURFACE
    assert at_end.any()
    assert not at_end.all()
    return LaplaceSystem.assemble(voxmap)


@pytest.mark.parametrize("where", ["between", "on the outer layer"])
@pytest.mark.parametrize("end", [0, -1])
def test_ends_satisfy_the_polar_stencil_of_a_torso(where, end):
    system = between() if where == "between" else touching()
    grid = system.grid
    b = grid.unflatten(system.right_side(2.0, 1.0))[:, :, end]
    fixed = system.voxmap.region[:, :, end] == SURFACE
    step, worst = grid.r_step, 0.0
    for i, j in itertools.product(range(1, grid.shape[0] - 1), range(grid.shape[1])):
        if fixed[i, j]:
            continue
        r, turn = grid.r[i], grid.shape[1]

        def seen(i2, j2, a=(i, j), turn=turn):
            """The neighbour's value, a ghost of one's own beyond the surface."""
            k = end % grid.shape[2]
            own = ghost(system.voxmap, (*a, k), (i2, j2 % turn, k))
            return float(b[i2, j2 % turn] + own * b[a])

        rest = (
            (1 + step / (2 * r)) * seen(i + 1, j)
            + (1 - step / (2 * r)) * seen(i - 1, j)
            - 2 * b[i, j]
            + (step / (r * grid.theta_step)) ** 2
            * (seen(i, j + 1) + seen(i, j - 1) - 2 * b[i, j])
        )
        worst = max(worst, abs(rest))
    assert worst < 1e-12
    # and what is given: on the inner layer, on the surface, on the rest of the outer
    np.testing.assert_allclose(b[0], 2.0, rtol=1e-12)
    np.testing.assert_array_equal(b[fixed], 0.0)
    np.testing.assert_allclose(b[-1, ~fixed[-1]], -1.0, rtol=1e-12)


PLAIN = CylindricalGrid(0.03, 0.18, 0.0, 0.3, shape=(5, 8, 6))


def test_conductances_are_in_the_ratio_of_the_conductivities():
    k_r, k_theta, k_z = 2.0, 0.5, 3.0
    own = {f.name: getattr(PLAIN, f.name) for f in fields(PLAIN)}
    stretch = {"theta_stretch": (k_r / k_theta) ** 0.5, "z_stretch": (k_r / k_z) ** 0.5}
    variant = VariantGrid(**own, **stretch)
    plain, other = conductances(PLAIN), conductances(variant)
    ratios = [np.asarray(b) / np.asarray(a) for a, b in zip(plain, other, strict=True)]
    along_r, along_theta, along_z = (r[np.isfinite(r)] for r in ratios)
    for values, k in ((along_theta, k_theta), (along_z, k_z)):
        np.testing.assert_allclose(values / along_r.flat[0], k / k_r, rtol=1e-12)
    np.testing.assert_allclose(along_r, along_r.flat[0], rtol=1e-12)


def test_the_steps_alone_differ():
    own = {f.name: getattr(PLAIN, f.name) for f in fields(PLAIN)}
    variant = VariantGrid(**own, theta_stretch=2.0, z_stretch=0.25)
    np.testing.assert_array_equal(variant.r, PLAIN.r)
    assert variant.theta_step == pytest.approx(2.0 * PLAIN.theta_step)
    assert variant.z_step == pytest.approx(0.25 * PLAIN.z_step)
    assert VariantGrid(**own).theta_step == PLAIN.theta_step

"""Other conductivities are the plain operator on a grid with other steps."""

from dataclasses import fields

import numpy as np
import pytest

from ttus_opt.laplace.multigrid.coarsening import conductances
from ttus_opt.laplace.variant_grid import VariantGrid
from ttus_opt.voxmap.grid import CylindricalGrid

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

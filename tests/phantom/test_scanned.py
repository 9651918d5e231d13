import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.phantom import Torso
from ttus_opt.phantom.torso import ScannedTorso
from ttus_opt.scan.surface import Surface


def surface_of(torso, length=0.32, n_z=41):
    theta = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    z = np.linspace(0.0, length, n_z)
    return Surface.from_radius(torso.radius(theta[:, None], z), z - 0.1)


def test_shape_is_that_of_the_scan_and_tissue_that_of_the_torso():
    shape, tissue = Torso(swell=0.03), Torso(soft=33e3, half_axes=(0.2, 0.2))
    torso = ScannedTorso.of(surface_of(shape), tissue)
    theta, z = np.linspace(0.0, 6.2, 37), np.linspace(0.02, 0.28, 37)
    # smoothing a slow swell over 6 mm along z: below a tenth of a millimetre
    assert torso.radius(theta, z) == pytest.approx(shape.radius(theta, z), abs=1e-4)
    assert torso.soft == 33e3
    assert torso.half_axes == pytest.approx(shape.half_axes, rel=0.05)


def test_radius_closes_around_the_body_with_its_slope():
    rng = np.random.default_rng(1)
    z = np.linspace(0.0, 0.3, 31)
    surface = Surface.from_radius(0.12 + 0.003 * rng.standard_normal((120, 31)), z)
    torso = ScannedTorso.of(surface, Torso())
    h, height = 1e-4, np.full(5, 0.11)
    around = torso.radius(np.array([-2, -1, 0, 1, 2]) * h, height)
    third = np.diff(around, 3)
    assert np.abs(third).max() < 1e-9  # a kink of 1 mm/rad would be 1e-7


def test_refuses_a_scan_that_is_too_short_or_none():
    with pytest.raises(GeometryError, match="longer scan"):
        ScannedTorso.of(surface_of(Torso(), length=0.2), Torso())
    refuses(InputError, "no surface", ScannedTorso().radius, np.zeros(1), np.zeros(1))

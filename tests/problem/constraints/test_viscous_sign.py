"""The sign of viscosities."""

import numpy as np

from tests.problem.constraints.declared import SCENE, bounds
from ttus_opt.problem.constraints.viscous_sign import ViscousSign


def test_viscosity_is_not_negative_in_any_patch():
    viscous = bounds(ViscousSign(SCENE, 6).rows())
    assert (viscous.variable, len(viscous.lower)) == ("c", 6)
    assert not viscous.lower.any() and (viscous.upper == np.inf).all()

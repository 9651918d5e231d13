"""One sign on either side of the surface."""

import numpy as np

from tests.problem.constraints.declared import REGION, SCENE, bounds
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.constraints.sign import Sign
from ttus_opt.voxmap.voxmap import INSIDE, OUTSIDE


def test_inside_is_not_negative_and_outside_not_positive():
    flat, sign = REGION.reshape(-1), bounds(Sign(SCENE).rows())
    np.testing.assert_array_equal(np.isfinite(sign.lower), flat == INSIDE)
    np.testing.assert_array_equal(np.isfinite(sign.upper), flat == OUTSIDE)
    assert not sign.lower[flat == INSIDE].any()
    assert not sign.upper[flat == OUTSIDE].any()


def test_sign_fit_has_the_sign():
    options = {"force_weight": 3.0, "torque_weight": 3.0}
    plain = fit(SCENE, "eq10", **options).field.values
    assert plain[REGION == INSIDE].min() < -1e-3
    signed = fit(SCENE, "eq10_sign", **options)
    p = signed.field.values
    assert p[REGION == INSIDE].min() > -1e-6
    assert p[REGION == OUTSIDE].max() < 1e-6
    assert signed.slacks["sign"].min() > -1e-6
    dual = signed.duals_by_name["sign"]
    assert dual.shape == (SCENE.n_voxels,)
    # a lower limit holds with a negative multiplier, and only where it is met
    assert dual.min() < -1e-6
    assert np.abs(
        dual * np.where(np.isfinite(p.reshape(-1)), p.reshape(-1), 0)
    ).max() < (1e-4)
    both = fit(SCENE, "eq10_sign_monotone", **options)
    assert both.objective >= signed.objective - 1e-9
    assert set(both.duals_by_name) == {"sign", "monotone"}

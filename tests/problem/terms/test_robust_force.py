"""Huber's penalty of forces: eq. 10 where its limit is wide, unmoved by outliers."""

import numpy as np
import pytest

from tests.conftest import small_scene, with_wrenches
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.terms.robust_force import RobustForceTerm

SCENE = small_scene("trilinear", n_poses=20)


@pytest.mark.slow
def test_huber_with_a_wide_limit_is_eq10():
    plain = fit(SCENE, "eq10", force_weight=0.1, torque_weight=0.1)
    wide = fit(SCENE, "robust", force_weight=0.1, torque_weight=0.1, limit=1e3)
    size = np.abs(plain.field.values).max()
    np.testing.assert_allclose(
        wide.field.values, plain.field.values, rtol=0, atol=1e-5 * size
    )
    assert wide.objective == pytest.approx(plain.objective, rel=1e-6)


def test_huber_bends_less_than_squares_to_an_outlier():
    """One frame with a slip of 50 N: the others keep their fit."""
    truth = SCENE.N @ SCENE.laplace.solve(SCENE.b)
    force = truth.reshape(-1, 3).copy()
    touched = int(np.argmax(np.linalg.norm(force, axis=1)))
    bad = force.copy()
    bad[touched] += 50.0
    scene = with_wrenches(SCENE, bad, np.zeros_like(SCENE.tau))
    others = np.delete(np.arange(len(force)), touched)

    def missed(name, **options):
        solution = fit(scene, name, force_weight=1.0, torque_weight=0.0, **options)
        rendered = (scene.N @ solution.field.values.reshape(-1)).reshape(-1, 3)
        return float(np.abs(rendered - force)[others].max())

    assert missed("robust", limit=0.1) < 0.2 * missed("eq10")


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_that_is_none_is_refused(limit):
    refuses(InputError, "limit must be positive", RobustForceTerm, SCENE, 1.0, limit)

"""The force's rows are those of the scene."""

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.problem.terms.force import ForceTerm

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=5)


def test_its_cost_is_the_squared_misfit_of_rendered_forces():
    rows = ForceTerm(SCENE).assembled
    p = np.random.default_rng(0).normal(size=SCENE.n_voxels)
    total = sum(
        float(np.sum((SCENE.N[3 * t : 3 * t + 3] @ p - force) ** 2))
        for t, force in enumerate(SCENE.trajectory.force)
    )
    r = rows.blocks["p"] @ p - rows.target
    assert ForceTerm(SCENE).penalty.value(r) == pytest.approx(total)
    assert ForceTerm.measures

"""Squares of the departure from a reference."""

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.terms.tikhonov import TikhonovTerm

SCENE = small_scene("trilinear")


def test_tikhonov_pulls_towards_its_reference():
    laplace = SCENE.voxmap.grid.unflatten(SCENE.laplace.solve(SCENE.b))
    for reference, target in (("laplace", laplace), ("zero", np.zeros_like(laplace))):
        free = SCENE.voxmap.grid.unflatten(SCENE.laplace.free)
        distance = [
            np.linalg.norm(
                (
                    fit(
                        SCENE,
                        "tikhonov",
                        force_weight=1.0,
                        ridge=ridge,
                        reference=reference,
                    ).field.values
                    - target
                )[free]
            )
            for ridge in (1e-4, 1e-2, 1.0)
        ]
        assert distance[0] > distance[1] > distance[2]
    with pytest.raises(InputError, match="reference must be one of laplace, zero"):
        TikhonovTerm(SCENE, reference="mean")

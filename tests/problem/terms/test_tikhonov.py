"""Squares of the departure from a reference."""

import numpy as np

from tests.conftest import small_scene
from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.terms.tikhonov import TikhonovTerm

SCENE = small_scene("trilinear")


def test_tikhonov_pulls_towards_its_reference():
    free = SCENE.voxmap.grid.unflatten(SCENE.laplace.free)
    laplace = SCENE.voxmap.grid.unflatten(SCENE.laplace.solve(SCENE.b))
    for reference, target in (("laplace", laplace), ("zero", np.zeros_like(laplace))):
        options, distance = {"force_weight": 1.0, "reference": reference}, []
        for ridge in (1e-4, 1e-2, 1.0):
            field = fit(SCENE, "tikhonov", ridge=ridge, **options).field
            distance.append(np.linalg.norm((field.values - target)[free]))
        assert distance[0] > distance[1] > distance[2]
    words = "reference must be one of laplace, zero"
    refuses(InputError, words, TikhonovTerm, SCENE, reference="mean")

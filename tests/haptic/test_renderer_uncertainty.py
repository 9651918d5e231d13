"""The standard deviation that a rendered force comes with."""

import math

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, small_scene
from ttus_opt.voxmap.uncertainty_map import UncertaintyMap

THETA = np.arange(8) * np.pi / 4.0


def test_a_frame_has_the_share_of_its_force():
    scene = small_scene("trilinear")
    field = tt.fit(scene, "eq10").field
    half = UncertaintyMap(THETA, np.array([0.0, 0.2]), np.full((8, 2), 0.5))
    renderer = tt.Renderer(field, scene.shell, uncertainty=half)
    told = scene.trajectory
    wrench = renderer.render(told.rotation[0], told.position[0])
    assert wrench.force_std == pytest.approx(0.5 * np.linalg.norm(wrench.force))
    assert wrench.force_std > 0.0
    away = renderer.render(told.rotation[0], 1.3 * told.position[0])
    assert away.force_std == 0.0
    plain = tt.Renderer(field, scene.shell).render(told.rotation[0], told.position[0])
    assert math.isnan(plain.force_std)


def test_a_map_of_no_or_another_body_is_refused():
    scene = small_scene("trilinear")
    field = tt.fit(scene, "eq10").field
    for bad in (True, 1.0, "field.nc"):
        with pytest.raises(InputError, match="uncertainty=True needs"):
            tt.Renderer(field, scene.shell, uncertainty=bad)
    for low, high in ((0.0, 2.0), (-0.5, 0.1)):
        other = UncertaintyMap(THETA, np.array([low, high]), np.zeros((8, 2)))
        why = f"has heights from {low:g} to {high:g} m, the field's body from 0 to 0.2 "
        with pytest.raises(InputError, match=f"{why}m: give the map of this field"):
            tt.Renderer(field, scene.shell, uncertainty=other)

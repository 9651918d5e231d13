"""The plain assembly is the compiled one, written differently."""

import numpy as np
import pytest

from tests.kit import small_scene
from tests.oracles.plain_assembly import plain_laplace


@pytest.mark.parametrize("shape", [(9, 20, 10), (8, 15, 7)], ids=["even", "odd"])
def test_laplace_is_the_same(shape):
    scene = small_scene(shape=shape)
    L, b = plain_laplace(scene.voxmap, scene.inner, scene.outer)
    assert abs(L - scene.L).max() < 1e-12 * abs(scene.L).max()
    np.testing.assert_allclose(b, scene.b, atol=1e-11)

"""The spring and damper that the data were made with are found."""

from __future__ import annotations

import numpy as np

from tests.comparators.contacts import contacts, made, samples
from ttus_opt.comparators.kelvin_voigt import KelvinVoigt


def test_kelvin_voigt_finds_spring_and_damper() -> None:
    rng = np.random.default_rng(2)
    found = contacts(200, rng)
    forces = np.array([7.0 * c.depth + 0.3 * c.rate for c in found])
    law = made(KelvinVoigt, forgetting=1.0)
    law._fit_law(samples(found, forces))
    np.testing.assert_allclose(
        law.per_patch, [[7.0, 0.3]] * len(law.per_patch), rtol=0.01
    )

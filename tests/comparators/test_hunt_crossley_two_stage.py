"""The law of two recursions finds the numbers its data were made with."""

from __future__ import annotations

import numpy as np

from tests.comparators.contacts import contacts, made, samples
from ttus_opt.comparators.hunt_crossley_two_stage import HuntCrossleyTwoStage


def test_two_stages_find_stiffness_damping_and_exponent() -> None:
    rng = np.random.default_rng(3)
    found = contacts(800, rng, rate=0.5)
    forces = np.array([c.depth**1.3 * (6.0 + 0.8 * c.rate) for c in found])
    law = made(HuntCrossleyTwoStage)
    law._fit_law(samples(found, forces))
    np.testing.assert_allclose(law.per_patch.mean(axis=0), [6.0, 0.8, 1.3], rtol=0.03)

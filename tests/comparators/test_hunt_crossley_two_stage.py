"""The law of two recursions finds the numbers its data were made with."""

import numpy as np

from tests.comparators.contacts import after_one_sample, contacts, made, samples
from ttus_opt.comparators.hunt_crossley_two_stage import HuntCrossleyTwoStage


def test_two_stages_find_stiffness_damping_and_exponent():
    rng = np.random.default_rng(3)
    found = contacts(800, rng, rate=0.5)
    forces = np.array([c.depth**1.3 * (6.0 + 0.8 * c.rate) for c in found])
    law = made(HuntCrossleyTwoStage)
    law._fit_law(samples(found, forces))
    np.testing.assert_allclose(law.per_patch.mean(axis=0), [6.0, 0.8, 1.3], rtol=0.03)


def test_the_first_sample_is_weighed_against_what_is_known_of_tissue():
    """5 ± 50 N, damping 0 ± 5 N s and, with these, Hertz's exponent 1.5 ± 5."""
    h, v, f = 0.8, 0.5, 9.0
    found = after_one_sample(HuntCrossleyTwoStage, h, v, f)
    rows = np.vstack([np.diag([1 / 50, 1 / 5]), h**1.5 * np.array([1.0, v])])
    (K, B), *_ = np.linalg.lstsq(rows, np.array([5.0 / 50, 0.0, f]))
    x, y = np.array([1 / 5, np.log(h)]), np.array([1.5 / 5, np.log(f / (K + B * v))])
    np.testing.assert_allclose(found, [K, B, x @ y / (x @ x)], rtol=1e-12)

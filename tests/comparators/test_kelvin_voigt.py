"""The spring and damper that the data were made with are found."""

import numpy as np

from tests.comparators.contacts import after_one_sample, contacts, made, samples
from ttus_opt.comparators.kelvin_voigt import KelvinVoigt


def test_kelvin_voigt_finds_spring_and_damper():
    rng = np.random.default_rng(2)
    found = contacts(200, rng)
    forces = np.array([7.0 * c.depth + 0.3 * c.rate for c in found])
    law = made(KelvinVoigt, forgetting=1.0)
    law._fit_law(samples(found, forces))
    np.testing.assert_allclose(
        law.per_patch, [[7.0, 0.3]] * len(law.per_patch), rtol=0.01
    )


def test_the_first_sample_is_weighed_against_what_is_known_of_tissue():
    """5 ± 50 N at 10 mm and no damping, 0 ± 5 N s, beside 9 ± 1 N of one sample."""
    found = after_one_sample(KelvinVoigt, 0.8, 0.5, 9.0)
    rows = np.vstack([np.diag([1 / 50, 1 / 5]), [0.8, 0.5]])
    expected, *_ = np.linalg.lstsq(rows, np.array([5.0 / 50, 0.0, 9.0]))
    np.testing.assert_allclose(found, expected, rtol=1e-12)

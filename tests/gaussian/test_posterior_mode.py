"""The most probable numbers against a Gaussian's own."""

import numpy as np

from ttus_opt.gaussian.posterior_mode import posterior_mode


def test_a_gaussian_evidence():
    """Evidence −½ (s − m)ᵀ K (s − m) and the unit prior: (K + I) s = K m."""
    K, m = np.array([[30.0, 5.0], [5.0, 80.0]]), np.array([2.0, -1.0])

    def log_evidence(s):
        return float(-0.5 * (s - m) @ K @ (s - m))

    found = posterior_mode(log_evidence, 2, 200)
    exact = np.linalg.solve(K + np.eye(2), K @ m)
    np.testing.assert_allclose(found.steps, exact, atol=0.1)
    best = log_evidence(exact) - 0.5 * exact @ exact
    assert best - 0.1 <= found.log_posterior <= best


def test_it_climbs_the_higher_of_two_hills_where_it_may_begin_there():
    def log_evidence(s):
        hills = np.exp(-20.0 * (s[0] - np.array([-1.5, 1.5])) ** 2)
        return float(hills @ [10.0, 20.0])

    found = posterior_mode(log_evidence, 1, 200, [np.array([1.4]), np.array([-1.5])])
    assert abs(found.steps[0] - 1.5) < 0.1


def test_without_evidence_the_prior_stays():
    calls = []
    found = posterior_mode(lambda s: calls.append(s) or 0.0, 3, 40)
    assert np.abs(found.steps).max() < 0.3
    evaluations = len(calls)
    assert evaluations < 20


def test_it_ends_after_the_most_evaluations():
    """Along a curved ridge, of which a search needs many; a last line is finished."""
    calls = []

    def ridge(s):
        calls.append(s)
        return float(-100.0 * (s[1] - s[0] ** 2) ** 2 - (1.0 - s[0]) ** 2)

    counts = []
    for most in (9, 30, 3000):
        calls.clear()
        posterior_mode(ridge, 2, most)
        counts.append(len(calls))
    assert 9 <= counts[0] <= 30 < counts[2] and counts[0] < counts[1] < counts[2]

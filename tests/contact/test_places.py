"""Runs of frames: presses, and places within them."""

import numpy as np
import pytest

from ttus_opt.contact.places import UNKNOWN, place_errors, places, runs


def test_a_run_ends_with_contact_and_with_a_recording():
    touching = np.array([False, True, True, False, False, True, True])
    segment = np.array([0, 0, 0, 0, 1, 1, 2])
    assert runs(touching, segment).tolist() == [0, 1, 1, 2, 3, 4, 5]


def test_a_place_ends_with_a_press_and_where_the_probe_has_moved_on():
    along = np.zeros((7, 3))
    along[:, 2] = [0.0, 0.01, 0.02, 0.05, 0.06, 0.06, 0.06]
    press = np.array([0, 0, 0, 0, 0, 4, 4])
    assert places(press, along).tolist() == [0, 0, 0, 1, 1, 2, 2]


def test_the_size_of_a_place_may_be_told():
    press = np.zeros(4, dtype=np.int64)
    along = np.column_stack([0.01 * np.arange(4), np.zeros(4), np.zeros(4)])
    assert places(press, along, 0.015).tolist() == [0, 0, 1, 1]


FRAMES, DRAWS = 6, 200


class Recordings:
    """Rows t = B p + μ g + e of a field p over places, its prior of covariance K.

    Each frame has a row along the elastic force and one across it. Drag reverses in
    the first and changes its sense from place to place in the second.
    """

    def __init__(self, n_places, signal=64.0):
        depth = np.tile(1.0 + np.sin(np.linspace(0.0, np.pi, FRAMES)), n_places)
        own = np.repeat(np.arange(n_places), FRAMES)
        at = 1.5 * own + np.tile(np.linspace(-0.3, 0.3, FRAMES), n_places)
        near = np.exp(-0.5 * (at[:, None] - at) ** 2)
        self.field = 0.5 * signal * near * np.outer(depth, depth)
        lean = np.tile(np.linspace(-0.15, 0.15, FRAMES), n_places)
        variances, axes = np.linalg.eigh(self.field)
        self.root = axes * np.sqrt(np.maximum(variances, 0.0))
        self.rows = np.concatenate([np.eye(len(at)), np.diag(lean)])
        sense = np.tile(np.repeat([1.0, -1.0], FRAMES // 2), n_places)
        self.drag = np.concatenate([depth * sense, 3.0 * depth * (-1.0) ** own])
        self.depth, self.place = np.tile(depth, 2), np.tile(own, 2)
        both = self.rows @ self.field @ self.rows.T
        self.inverse = np.linalg.inv(np.eye(len(both)) + both)
        self.slope = self.inverse @ self.drag  # -du/dμ
        self.half = float(self.drag @ self.slope)  # J''/2

    def drawn(self, shared, rng):
        """Measurements at μ = 0; errors in proportion to force, alike in a place."""
        field = self.root @ rng.standard_normal(len(self.field))
        n = len(self.drag)
        kind = 2 * self.place + (np.arange(n) >= n // 2)
        alike = rng.standard_normal(2 * n)[kind] * self.depth
        return np.asarray(self.rows @ field + rng.standard_normal(n) + shared * alike)

    def fitted(self, t):
        """μ̂, its standard error for independent rows, and that by places."""
        mu = float(self.slope @ t) / self.half
        rest = self.inverse @ (t - mu * self.drag)
        variance = float(rest @ (t - mu * self.drag)) / (len(t) - 1)
        usual = np.sqrt(variance / self.half)
        inverse = np.array([0.5 / self.half])
        pull = -self.slope[:, None] * inverse
        told = place_errors(np.array([usual]), rest, pull, inverse, self.place)
        return mu, float(usual), told

    def jackknife(self, t):
        """The standard error from fits with a place left out."""
        found = []
        for k in np.unique(self.place):
            left = np.flatnonzero(self.place != k)
            V = self.rows[left] @ self.field @ self.rows[left].T
            V = V + np.eye(len(left))
            weighed = np.linalg.solve(V, self.drag[left])
            found.append(weighed @ t[left] / (weighed @ self.drag[left]))
        return float(np.sqrt(len(found) - 1) * np.std(found))


def coverage(shared):
    """Share of draws whose 95 % interval covers μ: for independent rows, by places."""
    recordings, rng = Recordings(20), np.random.default_rng(5)
    usual, told = np.zeros((2, DRAWS), dtype=bool)
    for i in range(DRAWS):
        mu, error, by_place = recordings.fitted(recordings.drawn(shared, rng))
        usual[i] = abs(mu) < 1.96 * error
        told[i] = abs(mu) < 1.96 * by_place.errors[0]
    return float(usual.mean()), float(told.mean())


def test_intervals_cover_what_places_share():
    usual, told = coverage(shared=1.0)
    assert usual < 0.7
    assert 0.91 < told < 0.98  # 95 ± 1.5 %


def test_intervals_are_no_wider_where_they_share_nothing():
    usual, told = coverage(shared=0.0)
    assert 0.92 < usual <= told < 0.99


@pytest.mark.parametrize("signal", [1.0, 64.0, 1000.0])
def test_it_is_about_what_leaving_out_places_gives(signal):
    recordings, rng = Recordings(15, signal), np.random.default_rng(2)
    ratios = []
    for _ in range(10):
        t = recordings.drawn(1.0, rng)
        _, usual, told = recordings.fitted(t)
        assert told.remarks == ("",)
        assert told.errors[0] > 1.4 * usual
        ratios.append(told.errors[0] / recordings.jackknife(t))
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.1)


def test_without_a_field_it_is_the_cluster_robust_error_of_least_squares():
    rng = np.random.default_rng(3)
    g, place = rng.normal(size=40), np.repeat(np.arange(8), 5)
    t = 0.7 * g + rng.normal(size=40) + 2.0 * rng.normal(size=8)[place]
    mu = g @ t / (g @ g)
    e = t - mu * g
    usual = np.sqrt(e @ e / 39 / (g @ g))
    inverse = np.array([0.5 / (g @ g)])
    pull = -g[:, None] * inverse
    told = place_errors(np.array([usual]), e, pull, inverse, place)
    sums = np.array([g[place == k] @ e[place == k] for k in range(8)])
    w = np.array([g[place == k] @ g[place == k] for k in range(8)])
    n = w.sum() ** 2 / (w**2).sum()
    expected = np.sqrt(40 / 39 * n / (n - 1) * (sums**2).sum()) / (g @ g)
    assert told.errors[0] == pytest.approx(max(expected, usual))


def test_residuals_of_a_value_beside_the_optimum_are_no_errors():
    rng = np.random.default_rng(4)
    g, place = rng.normal(size=80), np.repeat(np.arange(16), 5)
    g = 1.0 + 0.3 * g
    e = rng.normal(size=80) + 2.0 * rng.normal(size=16)[place]
    e -= g * (g @ e) / (g @ g)
    inverse, usual = np.array([0.5 / (g @ g)]), np.array([0.01])
    at, off = (
        place_errors(usual, rest, -g[:, None] * inverse, inverse, place).errors[0]
        * np.linalg.norm(rest)  # κ is σ̂² over their mean square
        for rest in (e, e + g)
    )
    assert off == pytest.approx(at)


def test_a_parameter_of_the_prior_keeps_its_error():
    """Where the measured rows have no part in its variance, places do not matter."""
    rest, place = np.ones(12), np.repeat(np.arange(6), 2)
    change = 1e-3 * np.ones((12, 1))
    told = place_errors(np.array([0.2]), rest, change, np.ones(1), place)
    assert told.errors[0] == 0.2
    assert told.remarks == ("",)


def test_of_few_places_the_usual_error_is_told_with_a_word():
    rest, change = np.ones(12), np.ones((12, 1))
    few = place_errors(
        np.array([0.2]), rest, change, 24.0 * np.ones(1), np.repeat(np.arange(4), 3)
    )
    assert few.errors[0] == 0.2
    assert few.remarks == (UNKNOWN,)
    # one place of many that has all the sliding is one place
    change[3:] = 1e-3
    one = place_errors(
        np.array([0.2]), rest, change, 6.0 * np.ones(1), np.repeat(np.arange(6), 2)
    )
    assert one.remarks == (UNKNOWN,)

"""The likeliest hyperparameters of densities whose maximum is known."""

from __future__ import annotations

import numpy as np
import pytest

from ttus_opt.fitting.hyperparameters import (
    FARTHEST,
    Prior,
    maximise,
    maximise_by_slope,
)

WEIGHT, FRICTION = (
    Prior("weight", 10.0, 2.0),
    Prior("friction", 0.0, 0.5, linear=True, highest=1.0),
)


def density(values: np.ndarray) -> float:
    """Log weight around log 30 with 0.1, friction around 0.25 with 0.01, normal."""
    weight, friction = values
    return float(
        -0.5 * (np.log(weight / 30.0) / 0.1) ** 2
        - 0.5 * ((friction - 0.25) / 0.01) ** 2
    )


def test_the_posterior_of_a_normal_density_is_known() -> None:
    found = maximise(density, [WEIGHT, FRICTION])
    weight, friction = found.found
    assert weight.value == pytest.approx(30.0, rel=0.02)
    assert weight.spread == pytest.approx((0.1**-2 + 2.0**-2) ** -0.5, rel=0.05)
    assert friction.value == pytest.approx(0.25, abs=0.002)
    assert friction.spread == pytest.approx(0.01, rel=0.05)
    assert weight.determined and friction.determined
    # both integrals are Gaussian: the product of their widths over the priors'
    expected = np.log(weight.spread / 2.0) + np.log(friction.spread / 0.5)
    assert found.log_marginal - found.log_posterior == pytest.approx(expected, abs=0.1)


def test_what_the_data_do_not_bear_keeps_its_prior_value() -> None:
    found = maximise(lambda v: density(np.array([v[0], 0.25])), [WEIGHT, FRICTION])
    weight, friction = found.found
    assert not friction.determined and friction.value == 0.0
    assert np.isnan(friction.spread)
    assert weight.determined and weight.value == pytest.approx(30.0, rel=0.02)
    nothing = maximise(lambda _: 0.0, [WEIGHT])
    assert nothing.found[0].value == 10.0 and not nothing.found[0].determined
    assert nothing.log_marginal == nothing.log_posterior == 0.0


@pytest.mark.parametrize("correlation", [-0.9, 0.6])
def test_what_is_known_of_one_counts_for_the_other(correlation: float) -> None:
    """A normal density whose errors are correlated; spreads by the dense inverse."""
    std, medians = np.array([0.5, 0.1]), np.array([np.log(30.0), 0.25])
    mixed = correlation * std[0] * std[1]
    precision = np.linalg.inv(np.diag(std**2) + mixed * (1.0 - np.eye(2)))
    prior = np.diag([WEIGHT.spread, FRICTION.spread])

    def correlated(values: np.ndarray) -> float:
        off = np.array([np.log(values[0]), values[1]]) - medians
        return float(-0.5 * off @ precision @ off)

    found = maximise(correlated, [WEIGHT, FRICTION])
    curvature = prior @ precision @ prior + np.eye(2)
    spreads = np.sqrt(np.diag(prior @ np.linalg.inv(curvature) @ prior))
    assert [each.spread for each in found.found] == pytest.approx(spreads, rel=1e-3)
    share = found.log_marginal - found.log_posterior
    assert share == pytest.approx(-0.5 * np.log(np.linalg.det(curvature)), rel=1e-3)


def bent(values: np.ndarray) -> tuple[float, np.ndarray]:
    """A density that is not normal, its hyperparameters correlated, and its slope."""
    weight, friction = values
    x, y = np.log(weight / 30.0), friction - 0.25
    a, b = x / 0.5 + y / 0.1, y / 0.05
    value = -0.5 * (a**2 + b**2) - 0.01 * a**4
    by_a, by_b = -a - 0.04 * a**3, -b
    return float(value), np.array([by_a / 0.5 / weight, by_a / 0.1 + by_b / 0.05])


def test_by_its_slope_the_same_maximum_is_found() -> None:
    priors, asked = [WEIGHT, FRICTION], []

    def counted(values: np.ndarray) -> float:
        asked.append(0)
        return bent(values)[0]

    def counted_slope(values: np.ndarray) -> tuple[float, np.ndarray]:
        asked.append(1)
        return bent(values)

    slow, fast = maximise(counted, priors), maximise_by_slope(counted_slope, priors)
    assert fast.log_posterior == pytest.approx(slow.log_posterior, abs=0.01)
    assert fast.log_posterior >= slow.log_posterior - 1e-3
    assert fast.log_marginal == pytest.approx(slow.log_marginal, abs=0.05)
    for one, other in zip(fast.found, slow.found, strict=True):
        assert one.determined and other.determined
        assert one.value == pytest.approx(other.value, rel=0.03)
        assert one.spread == pytest.approx(other.spread, rel=0.05)
    assert asked.count(1) < 0.6 * asked.count(0)
    asked.clear()
    again = maximise_by_slope(counted_slope, priors, fast.found)
    assert again.log_posterior == pytest.approx(fast.log_posterior, abs=1e-6)
    assert len(asked) <= 8  # two and the Hessian's, where it starts at the maximum


def test_by_slope_correlated_spreads_are_those_of_the_dense_inverse() -> None:
    """Three normal hyperparameters: the signs of all three correlations count."""
    third = Prior("time", 0.5, 1.0)
    priors, medians = [WEIGHT, FRICTION, third], np.array([np.log(30.0), 0.25, 0.0])
    std = np.array([0.5, 0.1, 0.3])
    correlation = np.array([[1.0, 0.6, 0.5], [0.6, 1.0, -0.3], [0.5, -0.3, 1.0]])
    precision = np.linalg.inv(std[:, None] * correlation * std)
    prior = np.diag([each.spread for each in priors])

    def correlated(values: np.ndarray) -> tuple[float, np.ndarray]:
        weight, friction, time = values
        off = np.array([np.log(weight), friction, np.log(time / 0.5)]) - medians
        slope = -precision @ off / [weight, 1.0, time]
        return float(-0.5 * off @ precision @ off), slope

    found = maximise_by_slope(correlated, priors)
    curvature = prior @ precision @ prior + np.eye(3)
    spreads = np.sqrt(np.diag(prior @ np.linalg.inv(curvature) @ prior))
    assert [each.spread for each in found.found] == pytest.approx(spreads, rel=1e-3)
    share = found.log_marginal - found.log_posterior
    assert share == pytest.approx(-0.5 * np.log(np.linalg.det(curvature)), rel=1e-3)


def test_what_has_no_slope_keeps_its_prior_value() -> None:
    def flat(values: np.ndarray) -> tuple[float, np.ndarray]:
        value, slope = bent(np.array([values[0], 0.25]))
        return value, slope * [1.0, 0.0]

    weight, friction = maximise_by_slope(flat, [WEIGHT, FRICTION]).found
    assert weight.determined and weight.value == pytest.approx(30.0, rel=0.1)
    assert not friction.determined and friction.value == 0.0


@pytest.mark.parametrize(("sign", "x"), [(1.0, FARTHEST), (-1.0, -FARTHEST)])
def test_a_search_ends_at_the_bound(sign: float, x: float) -> None:
    """A density that grows steeply one way: friction ends at its largest value or 0."""

    def steep(values: np.ndarray) -> tuple[float, np.ndarray]:
        slope = sign * np.array([50.0 / values[0], 50.0])
        return float(sign * 50.0 * (np.log(values[0]) + values[1])), slope

    weight, friction = maximise_by_slope(steep, [WEIGHT, FRICTION]).found
    assert weight.at_bound and weight.value == pytest.approx(WEIGHT.value(x))
    assert friction.value == (1.0 if sign > 0 else 0.0)
    assert friction.at_bound == (sign > 0)


@pytest.mark.parametrize("prior", [WEIGHT, FRICTION, Prior("cut", 2.0, 1.0, highest=9)])
def test_a_prior_s_steps_and_derivative(prior: Prior) -> None:
    low, high = prior.range
    for x in (low, 0.5 * high, high):
        assert prior.steps(prior.value(x)) == pytest.approx(x) or prior.value(x) == 0.0
        inside = 1e-6 if x < high else -1e-6
        slope = (prior.value(x + inside) - prior.value(x)) / inside
        assert prior.derivative(x) == pytest.approx(slope, rel=1e-4)
    assert prior.value(high + 0.1) == prior.value(high)
    assert prior.value(low - 0.1) == prior.value(low)
    assert prior.derivative(high + 0.1) == prior.derivative(low - 0.1) == 0.0

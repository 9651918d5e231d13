"""The likeliest hyperparameters of densities whose maximum is known."""

from __future__ import annotations

import numpy as np
import pytest

from ttus_opt.fitting.hyperparameters import Prior, maximise

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

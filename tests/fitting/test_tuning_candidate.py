"""One formulation with its likeliest hyperparameters, by parts that are known."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest

from tests.fitting.test_weight_criteria import three_presses
from ttus_opt.errors import InputError
from ttus_opt.fitting import tuning_candidate
from ttus_opt.fitting.hyperparameters import Prior
from ttus_opt.fitting.tuning_candidate import (
    MOST_FRAMES,
    Candidate,
    KeptSeries,
    Values,
    _chosen,
    candidate,
    thinned,
)
from ttus_opt.fitting.tuning_series import TuningRows
from ttus_opt.problem.formulation import load
from ttus_opt.scene import Scene


@functools.cache
def scene() -> Scene:
    return three_presses()


@functools.cache
def rows() -> TuningRows:
    return TuningRows.of(load("eq10", scene()))


@functools.cache
def found() -> Candidate:
    return candidate("eq10", scene(), scene(), None, {}, KeptSeries())


def test_values_are_weights_of_a_row_s_noise() -> None:
    """Signal to noise over the prior's variance; others by their ratio to the first."""
    at = Values.of(np.array([64.0, 0.5, 0.1, 0.4, 0.2, 0.3]), 2, 8.0)
    np.testing.assert_allclose(at.weights, [8.0, 4.0])
    np.testing.assert_allclose(at.noise.sensor, [0.1, 0.4])
    assert (at.noise.correlation_time, at.coefficient) == (0.2, 0.3)
    alone = Values.of(np.array([64.0, 0.1, 0.2]), 1, 8.0)
    np.testing.assert_allclose(alone.noise.sensor, [0.1])
    assert (alone.noise.correlation_time, alone.coefficient) == (0.2, 0.0)


@pytest.mark.parametrize("best", [-1.0, 0.0, 0.7])
def test_an_option_s_likeliest_value_is_that_of_its_parabola(best: float) -> None:
    """Density and prior are normal in the logarithm: mean and spread by hand."""
    prior, sharp = Prior("option_skin", 1e-3, 2.0), 9.0

    def log_density(value: float) -> float:
        x = np.log(value / 1e-3) / 2.0
        return float(-0.5 * sharp * (x - best) ** 2 + 12.0)

    one = _chosen(log_density, prior)
    assert one.determined and one.prior_value == 1e-3
    mean, spread = sharp * best / (sharp + 1.0), 1.0 / np.sqrt(sharp + 1.0)
    # the search ends within 0.2 prior deviations of it
    assert np.log(one.value / 1e-3) / 2.0 == pytest.approx(mean, abs=0.2)
    assert one.spread == pytest.approx(2.0 * spread, rel=0.01)


def test_an_option_that_data_say_nothing_of_keeps_its_median() -> None:
    one = _chosen(lambda value: 0.0, Prior("option_skin", 1e-3, 2.0))
    assert not one.determined
    assert one.value == 1e-3 and np.isnan(one.spread)


def test_series_are_made_once_for_the_same_rows(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    kept, asked = KeptSeries(), []
    own = TuningRows.series

    def counted(self: TuningRows, weight: float) -> object:
        asked.append(weight)
        return own(self, weight)

    monkeypatch.setattr(TuningRows, "series", counted)
    first = kept(rows(), 10.0)
    assert kept(rows(), 10.0) is first and kept(rows(), 3.0) is first
    assert asked == [10.0]
    kept(rows(), 11.0)  # a larger weight asks for a larger basis
    assert asked == [10.0, 11.0]
    moved = replace(rows(), target=rows().target + 1.0)
    kept(moved, 3.0)
    assert asked == [10.0, 11.0, 3.0]


def test_few_frames_are_left_as_they_are(monkeypatch: pytest.MonkeyPatch) -> None:
    series = rows().series(10.0)
    assert series.frames <= MOST_FRAMES and thinned(series) is series
    monkeypatch.setattr(tuning_candidate, "MOST_FRAMES", 5)
    fewer = thinned(series)
    assert fewer.frames <= 5 + len(set(series.press.tolist()))
    assert set(fewer.press.tolist()) == set(series.press.tolist())


def test_no_other_hyperparameters_are_likelier() -> None:
    """Of data and priors together, each moved alone."""
    one = found()
    series = one.series
    priors = tuning_candidate._priors(one.rows)
    x = np.array([h.value for h in one.maximum.found])

    def log_posterior(values: np.ndarray) -> float:
        at = Values.of(values, len(one.rows.terms), one.variance)
        density = series.evidence(at.weights, at.noise, 1.0).log_density
        steps = [
            np.log(v / prior.median) / prior.spread
            for v, prior in zip(values, priors, strict=True)
        ]
        return float(density - 0.5 * np.square(steps).sum())

    assert not one.free_scale  # its boundary was given
    best = log_posterior(x)
    # over a condensed basis, whose trace misses tuning_candidate.MISSING at most
    assert best == pytest.approx(one.maximum.log_posterior, abs=0.1)
    for k, hyper in enumerate(one.maximum.found):
        for factor in (0.5, 2.0):
            moved = x.copy()
            moved[k] *= factor
            # what data do not bear stands at its median, not at the maximum
            if hyper.determined:
                assert log_posterior(moved) < best + 0.1, (hyper.name, factor)


def test_a_basis_is_enlarged_until_it_holds_for_what_was_found() -> None:
    one = found()
    assert one.largest * one.variance >= tuning_candidate.FIRST_SIGNAL
    at_bound = any(h.at_bound for h in one.maximum.found)
    assert at_bound or max(one.values.weights) <= one.largest * (1.0 + 1e-6)
    again = one.reaching(10.0 * one.largest * np.ones(2))
    assert len(again.images) >= len(one.series.images)
    assert one.reaching(one.values.weights) is one.series


def test_what_is_given_is_not_varied_and_other_options_are_left_out() -> None:
    given = {"force_weight": 2.0, "no_such_option": 1.0}
    one = candidate("eq10", scene(), scene(), {}, given, KeptSeries())
    assert one.build is not None and one.varied == ()
    weights = {t.name: t.weight for t in one.build(scene()).terms}
    assert weights["force"] == 2.0
    with pytest.raises(InputError):
        candidate("laplace_only", scene(), scene(), None, {}, KeptSeries())

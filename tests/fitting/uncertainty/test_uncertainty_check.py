"""Coverage and rank correlation where the truth is drawn from what is stated."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.stats

import ttus_opt as tt
from tests.fitting.uncertainty.test_field_uncertainty import exact, fitted
from tests.kit import InputError, presses, torso
from ttus_opt.fitting.uncertainty.uncertainty_check import check_uncertainty
from ttus_opt.fitting.uncertainty.wrench_uncertainty import WrenchUncertainty
from ttus_opt.haptic.field_wrench import FieldWrenches
from ttus_opt.report.metrics import compare


@pytest.mark.slow
def test_errors_drawn_from_the_uncertainty_are_covered():
    rng, many = np.random.default_rng(2), presses(torso(), 60, np.random.default_rng(5))
    stated, field = exact().std(many), fitted().field
    rendered = tt.evaluate(field, exact().scene.shell, many)
    errors = np.stack(
        [
            rng.multivariate_normal(np.zeros(6), c)
            for c in stated.covariance + stated.noise
        ]
    )
    truth = replace(
        many,
        force=rendered.rendered_force + errors[:, :3],
        torque=rendered.rendered_torque + errors[:, 3:],
    )
    found = check_uncertainty(
        exact(), tt.evaluate(field, exact().scene.shell, truth), truth
    )
    # 180 components, not all independent
    assert found.force_coverage == pytest.approx(0.95, abs=0.05)
    assert found.torque_coverage == pytest.approx(0.95, abs=0.05)
    far = replace(truth, force=truth.force + 4.0 * errors[:, :3])
    wrong = check_uncertainty(
        exact(), tt.evaluate(field, exact().scene.shell, far), far
    )
    assert wrong.force_coverage < 0.7


def test_error_in_the_order_of_uncertainty_has_rank_correlation_one():
    many = presses(torso(), 12, np.random.default_rng(5))
    stated, field = exact().std(many), fitted().field
    rendered = tt.evaluate(field, exact().scene.shell, many)
    truth = replace(
        many, force=rendered.rendered_force + 0.1 * stated.force, torque=None
    )
    found = check_uncertainty(
        exact(), tt.evaluate(field, exact().scene.shell, truth), truth
    )
    assert found.force_rank_correlation == pytest.approx(1.0)
    assert found.force_coverage == 1.0 and np.isnan(found.torque_coverage)
    assert np.isnan(found.torque_total_rank_correlation)
    away = replace(truth, position=1.5 * truth.position)
    with pytest.raises(InputError, match="three frames in contact"):
        there = tt.evaluate(field, exact().scene.shell, away)
        check_uncertainty(exact(), there, away)
    with pytest.raises(InputError, match="belongs to another recording"):
        check_uncertainty(exact(), rendered, truth.select(slice(3)))


class _Stated:
    """What is stated, as it was given."""

    def __init__(self, std, noise):
        eye = np.eye(6)
        self.told = WrenchUncertainty(
            std[:, None, None] ** 2 * eye, noise[:, None, None] ** 2 * eye
        )

    def std(self, trajectory):
        return self.told


def test_correlations_of_frames_of_noise_and_of_places():
    """Errors that grow from place to place, and fall within."""
    n, each = 4, 5
    place, frame = np.repeat(np.arange(n), each), np.tile(np.arange(each), n)
    std = 1.0 + place + 0.1 * frame
    off = 2.0 + 2.0 * place - 0.3 * frame * place
    noise = 10.0 - std  # undoes the order
    zero, time = np.zeros((n * each, 3)), np.arange(n * each, dtype=np.float64)
    force = zero + np.array([1.0, 0.0, 0.0])
    recorded = tt.Trajectory(
        time,
        zero + 0.05 * place[:, None],
        np.tile(np.eye(3), (n * each, 1, 1)),
        force=force,
    )
    rendered = force + off[:, None] * np.array([0.0, 1.0, 0.0])
    wrenches = FieldWrenches(
        rendered, zero, np.ones(n * each, bool), np.zeros(n * each, int)
    )
    found = check_uncertainty(
        _Stated(std, noise), compare(recorded, wrenches), recorded
    )
    expected = scipy.stats.spearmanr(off, std).statistic
    assert found.places == n and found.frames == n * each
    assert found.force_rank_correlation == pytest.approx(expected)
    assert found.force_place_rank_correlation == pytest.approx(1.0)
    whole = scipy.stats.spearmanr(off, np.hypot(std, noise)).statistic
    assert found.force_total_rank_correlation == pytest.approx(whole)
    assert whole < 0.0 < expected < 1.0
    left = [
        scipy.stats.spearmanr(off[place != i], std[place != i]).statistic
        for i in range(n)
    ]
    jackknife = np.sqrt((n - 1) / n * np.sum((left - np.mean(left)) ** 2))
    assert found.force_rank_error == pytest.approx(jackknife)
    assert jackknife > 0.0


def test_a_curve_has_the_coverage_of_the_check_and_only_frames_in_contact():
    many = presses(torso(), 12, np.random.default_rng(6))
    stated, field = exact().std(many), fitted().field
    off = np.random.default_rng(7).standard_normal((len(many), 6))
    own = exact().scene.shell
    rendered = tt.evaluate(field, own, many)
    total = np.sqrt(np.einsum("tii->ti", stated.covariance + stated.noise))
    truth = replace(
        many,
        force=rendered.rendered_force + (1.5 * off * total)[:, :3],
        torque=rendered.rendered_torque + (1.5 * off * total)[:, 3:],
    )
    found = check_uncertainty(exact(), tt.evaluate(field, own, truth), truth)
    curve = found.curve
    assert curve.coverage == pytest.approx(found.force_coverage) != 1.0
    assert curve.torque[curve.level == 0.95] == pytest.approx(found.torque_coverage)
    touching = stated.force_size > 0.0
    whole = np.sqrt((stated.force**2 + stated.force_noise**2)[touching].sum(axis=1))
    assert curve.stated_N.min() >= whole.min() and curve.stated_N.max() <= whole.max()

"""Coverage and rank correlation where the truth is drawn from what is stated."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.conftest import presses, torso
from tests.fitting.test_doubt import exact, fitted
from ttus_opt.errors import InputError
from ttus_opt.fitting.doubt_check import check_doubt


@pytest.mark.slow
def test_errors_drawn_from_the_doubt_are_covered() -> None:
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
    found = check_doubt(exact(), tt.evaluate(field, exact().scene.shell, truth), truth)
    # 180 components, not all independent
    assert found.force_coverage == pytest.approx(0.95, abs=0.05)
    assert found.torque_coverage == pytest.approx(0.95, abs=0.05)
    far = replace(truth, force=truth.force + 4.0 * errors[:, :3])
    wrong = check_doubt(exact(), tt.evaluate(field, exact().scene.shell, far), far)
    assert wrong.force_coverage < 0.7


def test_error_in_the_order_of_doubt_has_rank_correlation_one() -> None:
    many = presses(torso(), 12, np.random.default_rng(5))
    stated, field = exact().std(many), fitted().field
    rendered = tt.evaluate(field, exact().scene.shell, many)
    truth = replace(
        many, force=rendered.rendered_force + 0.1 * stated.force, torque=None
    )
    found = check_doubt(exact(), tt.evaluate(field, exact().scene.shell, truth), truth)
    assert found.force_rank_correlation == pytest.approx(1.0)
    assert found.force_coverage == 1.0 and np.isnan(found.torque_coverage)
    away = replace(truth, position=1.5 * truth.position)
    with pytest.raises(InputError, match="fewer than three"):
        check_doubt(exact(), rendered, away)

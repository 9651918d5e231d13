import numpy as np
import pytest

from ttus_opt.experiment.scores import Row, meets
from ttus_opt.haptic.field_wrench import FieldWrenches
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.metrics import compare


def evaluation(factor, n=100, force=5.0, torque=0.05):
    """Every frame rendered at a factor of its own."""
    up = np.tile([0.0, force, 0.0], (n, 1))
    turn = np.tile([torque, 0.0, 0.0], (n, 1))
    own = Trajectory(
        np.arange(n) / 20, np.zeros((n, 3)), np.tile(np.eye(3), (n, 1, 1)), up, turn
    )
    factor = np.broadcast_to(factor, n)[:, None]
    rendered = FieldWrenches(
        factor * up, factor * turn, np.ones(n, bool), np.zeros(n, np.int64)
    )
    return compare(own, rendered)


def row(judged):
    return Row("lean", "press_test", False, "eq10", "true", judged.errors)


def test_medians_shares_and_the_worst_five_per_cent():
    factor = np.ones(100)
    factor[:60] = 1.05
    factor[-6:] = 1.5
    score = evaluation(factor).errors
    assert score.force_median_share == pytest.approx(0.05)
    assert score.force_median_N == pytest.approx(0.25)
    assert score.force_worst_N == pytest.approx(2.5)
    assert score.force_magnitude_error_N == pytest.approx(0.6 * 0.25 + 0.06 * 2.5)
    assert score.torque_share == pytest.approx(0.6 * 0.05 + 0.06 * 0.5)
    assert score.share_told_apart == pytest.approx(0.06)
    assert score.mean_force_N == pytest.approx(5.0)


@pytest.mark.parametrize(
    ("factor", "met"), [(1.06, True), (1.08, False), (1.16, False)]
)
def test_aims(factor, met):
    aims = meets(row(evaluation(factor)).score)
    assert aims["force"] is met
    assert aims["torque"] is (factor < 1.15)
    assert aims["angle"] and aims["torque angle"]


def test_nothing_is_met_where_nothing_touches_and_rows_survive_json():
    one = row(evaluation(1.0, force=0.1))
    assert np.isnan(one.score.force_median_N) and one.score.frames_in_contact == 0
    assert not any(meets(one.score).values())
    told = {k: None if v != v else v for k, v in one.as_dict().items()}
    assert Row.from_dict(told).as_dict() == pytest.approx(one.as_dict(), nan_ok=True)

"""What is said of a recording, and what is left out where it is not known."""

import math

import numpy as np
import pytest

from ttus_opt.cli.evaluate_command import RecordingLine, _draw, _lines
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.uncertainty.uncertainty_check import Calibration
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report import metrics

FOUND = Calibration(
    *(0.05, 0.002, 0.951, 0.932, 0.41, 0.2, 90, 3),
    force_rank_error=0.16,
    torque_rank_error=0.03,
    force_place_rank_correlation=0.68,
    torque_place_rank_correlation=-0.3,
    places=7,
)


def test_a_share_that_rounds_to_nothing_has_no_sign():
    (line,) = RecordingLine("a.csv", 100, -0.001).lines
    assert line == "a.csv: its presses lose 0 % of their work to hysteresis"


def test_all_that_is_known_is_said():
    line = RecordingLine("a.csv", 100, 0.123, FOUND)
    lost, uncertainty, ranks, deeper = line.lines
    assert lost == "a.csv: its presses lose 12 % of their work to hysteresis"
    assert (
        "0.050 N, 2.0 mN m" in uncertainty
        and "95.1 % of force and 93.2 % of" in uncertainty
    )
    assert ranks == (
        "a.csv: rank correlation of error and uncertainty 0.41 ± 0.16 for force and "
        "0.20 ± 0.03 for torque; between its 7 places 0.68 and -0.30"
    )
    assert deeper.startswith("a.csv: 3 frames")
    told = line.as_dict()
    assert (
        told["uncertainty"]["force_coverage"] == 0.951
        and "uncertainty_refused" not in told
    )


def test_what_is_not_known_is_left_out():
    assert RecordingLine("a.csv", 100, math.nan).lines == []
    assert "uncertainty" not in RecordingLine("a.csv", 100, math.nan).as_dict()
    force = Calibration(0.05, math.nan, 0.95, math.nan, 0.4, math.nan, 90)
    lines = RecordingLine("a.csv", 100, math.nan, force).lines
    assert lines[1] == "a.csv: rank correlation of error and uncertainty 0.40 for force"
    assert not any(word in lines[0] for word in ("mN m", "torque", "nan"))


def test_without_contact_there_is_no_angle():
    """Errors of a recording in the air, with torques and without."""
    still = np.zeros((3, 3))
    rendered = metrics.as_rendered(np.zeros((3, 6)))
    air = Trajectory(np.arange(3.0), still, np.tile(np.eye(3), (3, 1, 1)), still, still)
    told = " ".join(_lines(metrics.compare(air, rendered).errors, True))
    assert "–° over 0 of 3 frames" in told and "nan" not in told


def test_a_refusal_is_said():
    line = RecordingLine("a.csv", 2, math.nan, None, "fewer than three")
    assert line.lines == ["a.csv: no uncertainty: fewer than three"]
    assert line.as_dict()["uncertainty"] is None


def test_a_picture_of_nothing_is_refused_before_any_other_is_written(tmp_path):
    air = RecordingLine("a.csv", 100, math.nan, refused="fewer than three")
    forces, calibration = tmp_path / "forces.png", tmp_path / "calibration.png"
    found = None  # not drawn
    with pytest.raises(InputError, match=r"calibration.png: fewer than three"):
        _draw(found, [air], forces, calibration)
    assert not list(tmp_path.iterdir())

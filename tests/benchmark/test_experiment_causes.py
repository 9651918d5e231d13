"""The parts of `benchmarks/experiment_causes.py` that need no fit."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.experiment_causes import raised, too_deep
from ttus_opt.probe.trajectory import Trajectory


def pressed():
    """A probe pressed into a wall along its z axis, which is -x; then lifted."""
    turn = Rotation.from_euler("y", -90, degrees=True).as_matrix()
    force = np.array([[4.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.1, 0.0, 0.0]])
    return Trajectory(
        np.arange(3.0), np.zeros((3, 3)), np.tile(turn, (3, 1, 1)), force, 0.0 * force
    )


def test_reported_too_deep_on_average_over_contact():
    true = pressed()
    off = np.array([[-1e-3, 5e-3, 0.0], [-2e-3, 0.0, 7e-3], [9e-3, 0.0, 0.0]])
    reported = replace(true, position=off)
    assert too_deep(reported, true) == pytest.approx(1.5e-3)
    level = raised(reported, 1.5e-3)
    assert too_deep(level, true) == pytest.approx(0.0, abs=1e-12)

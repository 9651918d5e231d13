"""Stretches of a recording."""

import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt.core.errors import InputError
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.session.description import Part
from ttus_opt.session.recordings import cut


def test_stretches():
    time = np.arange(0.0, 10.0, 0.1) + 500.0
    turns = np.tile(np.eye(3), (100, 1, 1))
    whole = Trajectory(time, np.zeros((100, 3)), turns)
    first, second = Part("a", 1.0, 3.0), Part("b", 3.0, 9.0, fitted=False)
    found = cut(whole, [first, second], 500.0)
    assert found["a"].time[0] == pytest.approx(501.0)
    assert len(found["b"]) == pytest.approx(60, abs=1)
    refuses(InputError, "a has 0 frames from 1 to 3 s", cut, whole, [first], 0.0)
    with pytest.raises(InputError, match="overlap"):
        cut(whole, [first, Part("b", 2.0, 9.0, fitted=False)], 500.0)

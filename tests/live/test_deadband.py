import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from ttus_opt.live.deadband import differ
from ttus_opt.live.messages import Sample


def sample(position=(0, 0, 0), angle=0.0, force=(0, 0, 0)):
    rotation = Rotation.from_rotvec([np.radians(angle), 0, 0]).as_matrix()
    wrench = np.array([*force, 0.0, 0, 0])
    return Sample(0.0, rotation, np.array(position, float), wrench)


@pytest.mark.parametrize(
    ("change", "is_felt"),
    [
        ({}, False),
        ({"position": (0.9e-3, 0, 0)}, False),
        ({"position": (1.1e-3, 0, 0)}, True),
        ({"angle": 0.95}, False),
        ({"angle": 1.05}, True),
        ({"angle": 170.0}, True),
        ({"force": (0.35, 0, 0)}, False),
        ({"force": (0.37, 0, 0)}, True),
    ],
)
def test_just_noticeable(change, is_felt):
    assert differ(sample(**change), sample()) is is_felt


def test_large_forces_need_ten_percent():
    ten = sample(force=(10.0, 0, 0))
    assert not differ(sample(force=(10.9, 0, 0)), ten)
    assert differ(sample(force=(11.1, 0, 0)), ten)
    assert differ(sample(force=(10.0, 1.1, 0)), ten)  # direction

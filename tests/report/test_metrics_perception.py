import numpy as np
import pytest

from ttus_opt.report.metrics import noticeable


@pytest.mark.parametrize(
    ("measured", "rendered", "degrees", "felt"),
    [
        (10.0, 10.69, 0.0, False),  # 6.9 % of 10 N
        (10.0, 10.71, 0.0, True),
        (10.0, 9.29, 0.0, True),
        (2.0, 2.35, 0.0, False),  # 17 %, and below 0.36 N
        (2.0, 2.37, 0.0, True),
        (0.0, 0.37, 0.0, True),
        (10.0, 10.0, 17.9, False),
        (10.0, 10.0, 18.1, True),
    ],
)
def test_limits_of_magnitude_and_direction(measured, rendered, degrees, felt):
    force, force_hat = (np.array([[0.0, size, 0.0]]) for size in (measured, rendered))
    found = noticeable(force, force_hat, np.array([degrees]))
    assert found.tolist() == [felt]

"""The sign of a drag field."""

import numpy as np

from tests.problem.constraints.declared import REGION, SCENE, bounds
from ttus_opt.problem.constraints.drag_sign import DragSign
from ttus_opt.voxmap.voxmap import INSIDE, OUTSIDE


def test_drag_has_the_field_s_sign_and_none_on_the_surface():
    flat, drag = REGION.reshape(-1), bounds(DragSign(SCENE).rows())
    assert drag.variable == "q"
    np.testing.assert_array_equal(drag.upper == 0.0, flat != INSIDE)
    np.testing.assert_array_equal(drag.lower == 0.0, flat != OUTSIDE)

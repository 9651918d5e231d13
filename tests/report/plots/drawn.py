"""A half-seen torso, and what a picture drew."""

from typing import Any

import numpy as np

from tests.kit import torso
from ttus_opt.core.arrays import Array
from ttus_opt.scan.surface import Surface


def half_seen() -> Surface:
    full = torso()
    observed = np.broadcast_to(
        (np.sin(full.theta) > -0.2)[:, None], full.radius.shape
    ).copy()
    return Surface(
        full.theta, full.z, full.radius, full.radius_std, observed, full.axis
    )


def lines(axes: Any) -> dict[str, tuple[Array, Array]]:
    return {
        str(line.get_label()): (
            np.asarray(line.get_xdata(), float),
            np.asarray(line.get_ydata(), float),
        )
        for line in axes.lines
    }

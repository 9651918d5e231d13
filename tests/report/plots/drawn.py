"""A half-seen torso, and what a picture drew."""

import numpy as np

from tests.kit import torso
from ttus_opt.scan.surface import Surface


def half_seen():
    full = torso()
    observed = np.broadcast_to(
        (np.sin(full.theta) > -0.2)[:, None], full.radius.shape
    ).copy()
    return Surface(
        full.theta, full.z, full.radius, full.radius_std, observed, full.axis
    )


def lines(axes):
    return {
        str(line.get_label()): (
            np.asarray(line.get_xdata(), float),
            np.asarray(line.get_ydata(), float),
        )
        for line in axes.lines
    }

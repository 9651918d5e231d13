"""Tubes on which rows are refined, and the order at which their errors fall."""

import numpy as np

from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import Voxmap


def tube(n: int, n_theta: int = 8, n_z: int = 5) -> Voxmap:
    surface = Surface.from_radius(np.full((8, 3), 0.08), np.array([0.0, 0.1, 0.2]))
    return Voxmap.from_surface(
        surface, shape=(2 * n + 1, n_theta, n_z), r_inner=0.04, r_outer=0.12
    )


def orders(errors: list[float]) -> np.ndarray:
    return np.log2(np.array(errors[:-1]) / errors[1:])

"""Clouds of known shape."""

import numpy as np


def cylinder(rng, radius=0.15, noise=0.003):
    theta = rng.uniform(0, 2 * np.pi, 60_000)
    r = radius + noise * rng.standard_normal(theta.size)
    z = rng.uniform(-0.2, 0.2, theta.size)
    return np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=1)

"""Where a scan was seen from: the camera, if it is one view from the scan's origin.

A depth camera's points are in its own frame, with the camera at the origin. Such a scan
is told by its shape: it lies within the view of a camera, and each of its rays meets
the scene once. A body scanned all around, or from a place other than the origin, has
points of its front and of its back on one ray.
"""

from __future__ import annotations

import numpy as np

from ttus_opt.core.arrays import Array

#: Half the widest field of view of a depth camera [rad], and its least distance [m]
HALF_VIEW, LEAST_DISTANCE = np.radians(60.0), 0.2

#: Width of a bundle of rays [rad], and the depth within it that a slope explains [m]
BUNDLE, SLOPE = 0.01, 0.06

#: Share of bundles that may be deeper: outlines, flying pixels, grazing surfaces
DEEP_SHARE = 0.2


def camera_of(cloud: Array) -> Array | None:
    """The place from which a scan was seen, None if it is no single view.

    Args:
        cloud: Scan, shape (n, 3) [m].

    Returns:
        The scan's origin, shape (3,) [m].
    """
    distance = np.linalg.norm(cloud, axis=1)
    if not len(cloud) or np.quantile(distance, 0.01) < LEAST_DISTANCE:
        return None
    rays = cloud / np.maximum(distance, 1e-9)[:, None]
    middle = rays.mean(axis=0)
    middle /= max(float(np.linalg.norm(middle)), 1e-9)
    if np.quantile(rays @ middle, 0.01) < np.cos(HALF_VIEW):
        return None
    cell = np.floor(rays / BUNDLE).astype(np.int64)
    _, bundle, count = np.unique(cell, axis=0, return_inverse=True, return_counts=True)
    near, far = np.full(len(count), np.inf), np.zeros(len(count))
    np.minimum.at(near, bundle, distance)
    np.maximum.at(far, bundle, distance)
    several = count > 1
    if several.sum() < 10:  # too sparse to tell
        return None
    deep = (far - near)[several] > SLOPE
    return np.zeros(3) if deep.mean() <= DEEP_SHARE else None

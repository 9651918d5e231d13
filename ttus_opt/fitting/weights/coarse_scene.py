"""A scene on fewer voxels, where hyperparameters are estimated.

They depend on the field's covariance at the contacts, which has nearly the same shape
on a grid with a third of the voxels or fewer.
"""

from __future__ import annotations

import math
import warnings

from ttus_opt.contact.scene import BOUNDARY_SCALE, Scene, ScenePlan
from ttus_opt.core.errors import TtusWarning

#: About the most voxels of a coarse grid. Errors of discretisation count as noise: with
#: 16,000 voxels the bundled example on 345,600 gets weights less than half as large
MOST_VOXELS = 60_000


def coarse_shape(shape: tuple[int, ...], most: int = MOST_VOXELS) -> tuple[int, ...]:
    """The shape of a grid of about ``most`` voxels; the same where it has no more."""
    share = (most / math.prod(shape)) ** (1.0 / 3.0)
    if share >= 1.0:
        return shape
    return tuple(2 * max(round(share * n / 2), 4) for n in shape)


def coarser(scene: Scene) -> Scene:
    """The scene on about `MOST_VOXELS` voxels; itself where it has no more.

    A fitted boundary scale is fitted again, as the coarse surface lies elsewhere.
    """
    shape = coarse_shape(scene.voxmap.grid.shape, MOST_VOXELS)
    if shape == scene.voxmap.grid.shape:
        return scene
    fitted = BOUNDARY_SCALE in scene.parameters
    ratio = scene.outer / scene.inner if fitted else scene.outer
    plan = ScenePlan(
        shape,
        scene.voxmap.grid.r_inner,
        scene.voxmap.grid.r_outer,
        "fit" if fitted else scene.inner,
        ratio,
        scene.sampling,
        scene.voxmap.boundary,
        scene.voxmap.grid.sector,
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", TtusWarning)  # the scene itself has warned
        return plan.build(scene.voxmap.surface, scene.shell, scene.trajectory)

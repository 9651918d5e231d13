"""A field that pushes, with drag where asked for, and a pose deep in it."""

import numpy as np

from ttus_opt.contact.scene import Scene
from ttus_opt.voxmap.field import PotentialField

DRAG = {"friction_coefficient": 0.3}
TWIST = np.array([0.03, -0.02, 0.05, 0.4, 0.2, -0.3])


def pressing(
    scene: Scene, parameters: dict[str, float] | None = None
) -> PotentialField:
    """The Laplace field of a scene, which pushes."""
    values = scene.voxmap.grid.unflatten(scene.laplace.solve(scene.b))
    return PotentialField(scene.voxmap, values, scene.sampling, parameters or {})


def deepest_pose(scene: Scene) -> tuple[np.ndarray, np.ndarray]:
    k = int(scene.rows.contact_points.argmax())
    return scene.trajectory.rotation[k], scene.trajectory.position[k]

"""Scenes whose wrenches come from the Laplace field and a known drag."""

import functools
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from tests.conftest import ellipsoid, torso
from ttus_opt.contact.friction import Sliding
from ttus_opt.contact.point_drag import drag_rows
from ttus_opt.contact.scene import Scene
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.voxmap import Voxmap


@functools.cache
def dragged_scene(
    acts_at: str,
    mu: float = 0.3,
    viscous: float = 0.0,
    shape: tuple[int, int, int] = (12, 30, 14),
    n: int = 60,
) -> Scene:
    """Wrenches made from the Laplace field and drag, without noise."""
    surface = torso()
    rng = np.random.default_rng(3)
    angle = 1.4 + 0.5 * np.sin(0.3 * np.arange(n))
    z = 0.1 + 0.03 * np.cos(0.21 * np.arange(n))
    r = surface.radius_at(angle, z) + 0.007 + 0.002 * np.sin(0.5 * np.arange(n))
    position = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    tilt = Rotation.from_rotvec(0.1 * np.cumsum(rng.normal(0, 0.2, (n, 3)), axis=0))
    bare = Trajectory(0.05 * np.arange(n), position, tilt.as_matrix())
    voxmap = Voxmap.from_surface(surface, shape=shape, r_inner=0.03)
    shell = ellipsoid(400)
    scene = Scene.assemble(
        voxmap, shell, bare, inner=3.0, outer=3.0, sampling="trilinear"
    )
    p = scene.laplace.solve(scene.b)
    sliding = Sliding.of(voxmap, shell, bare, acts_at)
    rows = drag_rows(scene.rows, sliding, voxmap, shell, bare, sampling="trilinear")
    force = (scene.N @ p - mu * (rows.force @ p)).reshape(-1, 3)
    force -= viscous * sliding.velocity
    torque = (scene.W @ p - mu * (rows.torque @ p)).reshape(-1, 3)
    torque -= np.cross(sliding.arm, viscous * sliding.velocity)
    return replace(scene, trajectory=replace(bare, force=force, torque=torque))

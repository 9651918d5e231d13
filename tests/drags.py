"""Fields with drag, and what they drag by plain numpy, point by point."""

import math
from dataclasses import replace

import numpy as np

import ttus_opt as tt
from tests.kit import ellipsoid, torso
from ttus_opt.contact.rows import contact_rows
from ttus_opt.probe.cylindrical import cylindrical

SURFACE = torso()


def end_share(grid, z):
    """Share of a depth that counts, 0 at both ends of a grid, 1 a voxel away."""
    voxels = np.minimum(z - grid.z_min, grid.z_max - z) / grid.z_step
    return np.clip(voxels, 0.0, 1.0)


VOXMAP = tt.Voxmap.from_surface(SURFACE, shape=(12, 30, 14), r_inner=0.03)

# the reference stands off the frame's origin, as a tool's does
_ELLIPSOID = ellipsoid(400, (0.02, 0.015, 0.012))
_OFFSET = np.array([0.004, -0.007, 0.03])
SHELL = replace(
    _ELLIPSOID,
    points=_ELLIPSOID.points + _OFFSET,
    reference=_ELLIPSOID.reference + _OFFSET,
)

_TILTED = np.array([0.48, -0.6, 0.64])
_AXIS = dict(zip(("drag_axis_x", "drag_axis_y", "drag_axis_z"), _TILTED, strict=True))

#: One of each kind of drag, by name
LAWS: dict[str, dict[str, float]] = {
    "none": {"boundary_scale": 2.0},
    "coulomb": {"friction_coefficient": 0.3},
    "coulomb-slow": {"friction_coefficient": 0.3, "drag_deadband": 0.05},
    "coulomb-reference": {
        "friction_coefficient": 0.3,
        "drag_at_reference": 1.0,
        **_AXIS,
    },
    "coulomb-points": {"friction_coefficient": 0.3, "drag_at_points": 1.0},
    "points-slow-viscous": {
        "friction_coefficient": 0.3,
        "drag_at_points": 1.0,
        "drag_deadband": 0.05,
        "viscous_coefficient": 20.0,
    },
    "viscous": {"viscous_coefficient": 20.0},
    "viscous-reference": {
        "viscous_coefficient": 20.0,
        "drag_at_reference": 1.0,
        **_AXIS,
    },
    "viscous-regions": {
        "viscous_coefficient": 20.0,
        "viscous_sectors": 12.0,
        "viscous_bands": 7.0,
        **{f"viscous_coefficient_{i}": 5.0 + i for i in range(84)},
    },
}


def pushing(sampling, parameters):
    """A field positive inside that grows with depth, different everywhere."""
    grid = VOXMAP.grid
    theta, z = np.meshgrid(grid.theta, grid.z, indexing="ij")
    depth = SURFACE.radius_at(theta, z)[None] - grid.r[:, None, None]
    bumps = 1.0 + 0.4 * np.sin(3 * theta) * np.cos(40 * z)
    return tt.PotentialField(VOXMAP, 100 * depth * bumps, sampling, parameters)


def normal_forces(field, shell, places):
    """Of every point at its place: what a probe of that point alone would feel."""
    n = len(places)
    dot = tt.PointShell(
        np.zeros((4, 3)),
        np.tile([1.0, 0.0, 0.0], (4, 1)),
        np.full(4, 2.5e-5),  # 1 cm² in all
        np.zeros(3),
    )
    rows = contact_rows(
        field.voxmap,
        dot,
        np.tile(np.eye(3), (n, 1, 1)),
        places,
        sampling=field.sampling,
    ).N[::3]
    felt = np.asarray(rows @ field.values.reshape(-1))
    if field.sampling != "voxel-mean":
        return felt * shell.areas / 1e-4
    sampled = np.diff(rows.indptr) > 0
    voxel = rows.indices  # of each that samples one
    felt[sampled] /= np.bincount(voxel)[voxel]
    return felt


def drag_by_points(field, shell, R, at, twist):
    """Coulomb drag of every point against its own sliding, shape (6,)."""
    points = shell.points @ R.T + at
    pressed = np.maximum(normal_forces(field, shell, points), 0.0)
    normals = shell.normals @ R.T
    moved = twist[:3] + np.cross(twist[3:], points - at)
    slid = moved - normals * np.sum(normals * moved, axis=1)[:, None]
    speed = np.linalg.norm(slid, axis=1)
    slow = field.parameters.get("drag_deadband", 2e-3)
    mu = field.parameters["friction_coefficient"]
    force = -mu * (pressed / np.maximum(speed, slow))[:, None] * slid
    arms = points - (R @ shell.reference + at)
    return np.concatenate([force.sum(axis=0), np.cross(arms, force).sum(axis=0)])


def drag_by_hand(field, shell, R, at, twist, contact_force):
    """Force and torque of drag from every point's depth, shape (6,)."""
    parameters = field.parameters
    points = shell.points @ R.T + at
    r, theta, z = cylindrical(points)
    grid = VOXMAP.grid
    depth = (SURFACE.radius_at(theta, z) - r) * end_share(grid, z)
    inside = (depth > 0) & (z >= grid.z_min) & (z <= grid.z_max)
    weight = np.where(inside, shell.areas * depth, 0.0)
    if not inside.any():
        return np.zeros(6)
    normal = weight @ (shell.normals @ R.T)
    normal /= np.linalg.norm(normal)
    centre = weight @ points / weight.sum()
    reference = R @ shell.reference + at
    acts, across = centre, normal
    if parameters.get("drag_at_reference"):
        acts, across = reference, R @ _TILTED
    slid = twist[:3] + np.cross(twist[3:], acts - at)
    slid = slid - across * (across @ slid)
    speed = np.linalg.norm(slid)
    force = np.zeros(3)
    by_points = np.zeros(6)
    if parameters.get("drag_at_points"):
        by_points = drag_by_points(field, shell, R, at, twist)
    elif mu := parameters.get("friction_coefficient"):
        size = mu * max(normal @ contact_force, 0.0)
        force -= size * slid / max(speed, parameters.get("drag_deadband", 2e-3))
    if c := parameters.get("viscous_coefficient"):
        sectors = int(parameters.get("viscous_sectors", 1))
        bands = int(parameters.get("viscous_bands", 1))
        turned = np.arctan2(centre[1], centre[0]) % (2 * np.pi) / (2 * np.pi)
        share = (centre[2] - grid.z_min) / (grid.z_max - grid.z_min)
        region = int(turned * sectors) * bands + int(np.clip(share, 0, 0.999) * bands)
        force -= parameters.get(f"viscous_coefficient_{region}", c) * slid
    return by_points + np.concatenate([force, np.cross(acts - reference, force)])


def unlimited(field):
    """A renderer of whatever forces."""
    return tt.Renderer(field, SHELL, force_limit=math.inf, torque_limit=math.inf)

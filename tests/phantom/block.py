"""A large soft block: the body whose contact with a sphere Hertz solved.

For a rigid sphere of radius R on an elastic half-space (Hertz 1881; Johnson,
Contact Mechanics, 1985, §4.2):

    F = 4/3 · E/(1 − ν²) · √R · d^{3/2},   contact radius a = √(R d).
"""

import math

import numpy as np

from ttus_opt.core.errors import InputError
from ttus_opt.phantom.elasticity import ElasticBody
from ttus_opt.phantom.torso import graded


def box_mesh(x, y, z):
    """Hexahedra (`skfem.MeshHex`) between node positions along x, y and z [m]."""
    from skfem import MeshHex

    mesh = MeshHex.init_tensor(x, y, z)
    return MeshHex(np.ascontiguousarray(mesh.p), np.ascontiguousarray(mesh.t))


def soft_block(size, pitch, reach, young, poisson):
    """A cube whose top face z = 0 is fine around the origin; its bottom is held.

    Args:
        size: Edge length [m].
        pitch: Node spacing in the patch and below it [m].
        reach: Half width of the square patch [m].
        young: Young's modulus [Pa].
        poisson: Poisson's ratio [–].

    Returns:
        The body; its skin patch is the fine square.

    Raises:
        InputError: The patch is not within the block.
    """
    if not 0.0 < pitch <= reach < size / 2:
        raise InputError(
            f"block of {size} m cannot hold a patch of ±{reach} m at {pitch} m: "
            "expected 0 < pitch <= reach < size / 2"
        )
    lateral = graded(-size / 2, size / 2, (-reach, reach), pitch, growth=1.5)
    depth = graded(-size, 0.0, (-reach, 0.0), pitch, growth=1.5)
    mesh = box_mesh(lateral, lateral, depth)
    x, y, z = np.asarray(mesh.p)
    inside = reach + 1e-9
    patch = np.flatnonzero((z > -1e-9) & (np.abs(x) < inside) & (np.abs(y) < inside))
    edge = np.maximum(np.abs(x[patch]), np.abs(y[patch])) > reach - 1e-9
    fixed = np.repeat((z < -size + 1e-9)[:, None], 3, axis=1)
    normals = np.tile([0.0, 0.0, 1.0], (len(patch), 1))

    def modulus(points):
        return np.full(points.shape[1:], young)

    return ElasticBody(mesh, modulus, poisson, fixed, patch, normals, edge)


def hertz_force(depth, radius, young, poisson):
    """Force of a rigid sphere on an elastic half-space [N].

    Args:
        depth: Indentation d [m], well below ``radius``.
        radius: Sphere's radius R [m].
        young: Young's modulus E [Pa].
        poisson: Poisson's ratio ν [–].

    Returns:
        The force [N].

    Examples:
        >>> round(hertz_force(1e-3, 0.05, 15e3, 0.45), 4)
        0.1773
    """
    return 4.0 / 3.0 * young / (1.0 - poisson**2) * math.sqrt(radius * depth) * depth

"""A rigid probe pressed into a patch of skin: wrench, Coulomb drag and damping.

Skin nodes move along their own normals. A node at x whose inward ray leaves the probe
at depth s must be pushed in by at least s; the nodal forces f_i along the inward
normals d_i solve the unilateral problem C f ≥ s (`solve_unilateral`). The probe is
smooth, so its contact force acts along the PROBE's outward normal n_i at that
point and has the component f_i along d_i. The wrench on the probe is

    F = −Σ N_i n_i,   N_i = f_i / (n_i · d_i),   τ = Σ (x_i + s_i d_i − p) × (−N_i n_i).

It is minus the gradient of the stored energy E = ½ f·C f with respect to the pose:
without drag the contact conserves energy. Coulomb drag adds −μ N_i t_i at every node,
where t_i is the direction in which the probe slides; it does not change N_i.

Tissue resists more when pressed faster (Hunt and Crossley, J. Appl. Mech. 42, 1975): if
the probe moves into the body with speed v_i at node i, N_i becomes
N_i max(0, 1 + b v_i). The work of this additional force is dissipated.

Forces push and never pull. The linear complementarity problem

    f ≥ 0,   C f − s ≥ 0,   f · (C f − s) = 0

for nodal forces f [N], compliance C [m/N] and probe depths s [m] has one solution if C
is positive definite. With C = RᵀR it is the optimality condition of the nonnegative
least-squares problem min ‖R f − R⁻ᵀs‖² over f ≥ 0 (Lawson and Hanson, Solving Least
Squares Problems, 1974, chapter 23).
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky, solve_triangular
from scipy.optimize import nnls

from ttus_opt.core.arguments import expect_not_negative
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import GeometryError, InputError
from ttus_opt.phantom.elasticity import SkinPatch
from ttus_opt.phantom.probe import EllipsoidProbe


def solve_unilateral(compliance: Array, depth: Array) -> Array:
    """Find the nodal forces that keep the skin out of the probe.

    Args:
        compliance: Symmetric positive definite, shape (n, n) [m/N].
        depth: How far the probe reaches below each node, shape (n,) [m].

    Returns:
        Inward nodal forces on the skin, zero where it does not touch, (n,) [N].

    Raises:
        InputError: The shapes disagree, or the compliance is not positive definite.
    """
    n = len(depth)
    if compliance.shape != (n, n):
        raise InputError(
            f"compliance must be ({n}, {n}) for {n} depths, got {compliance.shape}"
        )
    try:
        R = cholesky(compliance)
    except np.linalg.LinAlgError as error:
        raise InputError(
            "compliance is not positive definite: compute it again"
        ) from error
    forces, _ = nnls(R, solve_triangular(R, depth, trans="T"))
    return np.asarray(forces)


@dataclass(frozen=True)
class CoulombDrag:
    """Coulomb drag.

    Attributes:
        coefficient: μ, tangential over normal force while sliding [–].
        deadband: Sliding speed below which there is no drag [m/s].
    """

    coefficient: float = 0.0
    deadband: float = 5e-4

    def __post_init__(self) -> None:
        """Refuse a negative coefficient or deadband."""
        expect_not_negative(self.coefficient, "drag coefficient")
        expect_not_negative(self.deadband, "drag deadband", "m/s")


@dataclass(frozen=True)
class Motion:
    """Velocity of a pose, patient frame.

    Attributes:
        velocity: Velocity of the probe's centre, shape (3,) [m/s].
        angular_velocity: Angular velocity, shape (3,) [rad/s].
    """

    velocity: Array
    angular_velocity: Array


@dataclass(frozen=True)
class Contact:
    """The contact at one pose, patient frame.

    Attributes:
        force: Force on the probe, shape (3,) [N].
        torque: Torque on the probe about its centre, shape (3,) [N m].
        energy: Energy stored in the body [J].
        normal_forces: N_i of the k touching nodes, not negative, shape (k,) [N].
        nodes: Numbers of the touching nodes in the patch, shape (k,).
        points: Contact points, shape (k, 3) [m].
        probe_normals: The probe's outward normals at these points, shape (k, 3) [–].
    """

    force: Array
    torque: Array
    energy: float
    normal_forces: Array = field(repr=False)
    nodes: NDArray[np.intp] = field(repr=False)
    points: Array = field(repr=False)
    probe_normals: Array = field(repr=False)

    @classmethod
    def none(cls) -> Contact:
        """No contact."""
        nodes, places = np.empty(0, dtype=np.intp), np.empty((0, 3))
        zero = np.zeros(3)
        return cls(zero, zero.copy(), 0.0, np.empty(0), nodes, places, places)


def press(
    patch: SkinPatch,
    probe: EllipsoidProbe,
    rotation: Array,
    position: Array,
    *,
    motion: Motion | None = None,
    drag: CoulombDrag | None = None,
    damping: float = 0.0,
) -> Contact:
    """Press a probe into the skin.

    Args:
        patch: Skin and its compliance.
        probe: The rigid probe.
        rotation: Probe to patient, shape (3, 3) [–].
        position: The probe's centre, shape (3,) [m].
        motion: Velocity of the probe, on which drag and damping depend; at rest if
            None.
        drag: Coulomb drag, if any.
        damping: Hunt–Crossley coefficient b, not negative [s/m].

    Raises:
        GeometryError: The probe is not above the patch, its centre is below the
            undeformed skin, or it touches the patch's border.
        InputError: The damping is negative.
    """
    expect_not_negative(damping, "damping", "s/m")
    _check_above(patch, position)
    below, leaves = probe.reach(patch.points, -patch.normals, rotation, position)
    under = np.flatnonzero(np.isfinite(below))
    if not (under.size and (below[under] > 0.0).any()):
        return Contact.none()
    depth = below[under]
    compliance = patch.compliance[np.ix_(under, under)]
    forces = solve_unilateral(compliance, depth)
    touch = forces > 0.0
    nodes = under[touch]
    if patch.rim[nodes].any():
        raise GeometryError(
            "the probe touches the border of the skin patch, beyond which nothing is "
            "computed: keep it further inside or mesh a larger patch"
        )
    inward, outward = -patch.normals[nodes], leaves[nodes]
    normal_forces = forces[touch] / np.einsum("ij,ij->i", outward, inward)
    points = patch.points[nodes] + below[nodes, None] * inward
    if damping > 0.0 and motion is not None:
        speed = np.einsum("ij,ij->i", _velocities(points - position, motion), outward)
        normal_forces = normal_forces * np.maximum(0.0, 1.0 + damping * speed)
    on_probe = -normal_forces[:, None] * outward
    if drag is not None and motion is not None and drag.coefficient > 0.0:
        slide = _sliding_directions(points - position, outward, motion, drag.deadband)
        on_probe = on_probe - drag.coefficient * normal_forces[:, None] * slide
    return Contact(
        on_probe.sum(axis=0),
        np.cross(points - position, on_probe).sum(axis=0),
        0.5 * float(forces @ compliance @ forces),
        normal_forces,
        nodes,
        points,
        outward,
    )


def _check_above(patch: SkinPatch, position: Array) -> None:
    """Raise an error unless the probe's centre is above the interior of the patch."""
    away = position - patch.points
    nearest = int(np.argmin(np.einsum("ij,ij->i", away, away)))
    place = ", ".join(f"{v:.3f}" for v in position)
    if patch.rim[nearest]:
        raise GeometryError(
            f"probe centre ({place}) m is not above the skin patch: move it inside or "
            "mesh a larger patch"
        )
    if away[nearest] @ patch.normals[nearest] <= 0.0:
        raise GeometryError(
            f"probe centre ({place}) m is below the undeformed skin, which is too "
            "deep for linear elasticity: press less deep"
        )


def _velocities(levers: Array, motion: Motion) -> Array:
    """Velocities of the probe at points (k, 3) relative to its centre [m] [m/s]."""
    return np.asarray(motion.velocity + np.cross(motion.angular_velocity, levers))


def _sliding_directions(
    levers: Array, normals: Array, motion: Motion, deadband: float
) -> Array:
    """Unit directions of the probe's sliding, zero at rest, shape (k, 3) [–]."""
    velocity = _velocities(levers, motion)
    along = np.einsum("ij,ij->i", velocity, normals)
    tangential = velocity - along[:, None] * normals
    speed = np.linalg.norm(tangential, axis=1)
    moving = speed > deadband
    direction: Array = np.zeros_like(tangential)
    direction[moving] = tangential[moving] / speed[moving, None]
    return direction

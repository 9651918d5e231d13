"""Pressure field contact: traction integrated over the surface of equal pressure.

In the patient a pressure k d grows with the depth d below the surface; in the probe one
grows with the depth s below its own, ρ times as steep, unless it is rigid. The contact
surface is where both are equal; along the probe's inward normal n̂ from a vertex

    k d(x + s n̂) = ρ k s,

so that s = 0 for a rigid probe. The contact surface is a mesh; on each triangle the
pressure is linear, the triangle is cut where it is zero, and force and torque are
integrated exactly.

Source: R. Elandt, E. Drumwright, M. Sherman, A. Ruina, A pressure field model for fast,
robust approximation of net contact force and moment between nominally rigid objects,
IROS 2019, 8238–8245. The probe is the convex hull of its shell.
"""

from __future__ import annotations

import math
from typing import Unpack

import numpy as np

from ttus_opt.comparators.base import Given, OneStiffness
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import InputError
from ttus_opt.probe.mesh import TriangleMesh

#: Newton steps to equal pressure
STEPS = 3


class PressureField(OneStiffness):
    """Hydroelastic contact, one stiffness.

    Attributes:
        ratio: ρ, stiffness of the probe over that of the tissue; inf is rigid [–].
    """

    name = "pressure_field"
    summary = "equal-pressure surface, traction integrated (Elandt and others 2019)"

    def __init__(self, *, ratio: float = math.inf, **given: Unpack[Given]) -> None:
        super().__init__(**given)
        if not ratio > 1.0:
            raise InputError(
                f"the probe must be stiffer than the tissue, ratio > 1, got {ratio}"
            )
        self.ratio = ratio
        self._arm = self.shell.points - self.shell.reference
        any_face = np.arange(3)[None]
        self._faces = TriangleMesh(self.shell.points, any_face).convex_hull().faces

    def _unit_wrench(self, R: Array, at: Array) -> tuple[Array, int]:
        arm, depth = self._contact_surface(R, at)
        touching = int(np.count_nonzero(depth > 0.0))
        if not touching:
            return np.zeros(6), 0
        return integrated(arm, self._faces, depth), touching

    def _contact_surface(self, R: Array, at: Array) -> tuple[Array, Array]:
        """Vertices from the shell's reference, and their depth in the patient [m]."""
        reference = R @ self.shell.reference + at
        arm, inward = self._arm @ R.T, self.shell.normals @ R.T
        depth, normals = self.geometry.surface.depth(reference + arm)
        if math.isinf(self.ratio):
            return arm, depth
        shift, moved = np.zeros(len(depth)), arm
        for _ in range(STEPS):
            # Newton: along n̂ the patient's depth falls by the normals' cosine
            cosine = np.einsum("mi,mi->m", normals, inward)
            shift = shift + (depth - self.ratio * shift) / (self.ratio + cosine)
            moved = arm + shift[:, None] * inward
            depth, normals = self.geometry.surface.depth(reference + moved)
        return moved, depth


def integrated(arm: Array, faces: IntArray, pressure: Array) -> Array:
    """Force and torque of a pressure, linear on triangles and never below zero.

    Args:
        arm: Vertices from the reference point of torques, shape (n, 3) [m].
        faces: Counter-clockwise seen from outside the probe, shape (f, 3).
        pressure: Pressure of the vertices, negative without contact, (n,) [Pa].

    Returns:
        The wrench on the probe, into it, shape (6,) [N, N·m].
    """
    touching = faces[(pressure[faces] > 0.0).any(axis=1)]
    corners, p = arm[touching], pressure[touching]
    cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total, moment = _linear(corners, p)
    one = (p > 0.0).sum(axis=1) == 1
    two = (p > 0.0).sum(axis=1) == 2
    total[one], moment[one] = _one_above(corners[one], p[one])
    # the positive part is the whole minus the negative part
    below, below_moment = _one_above(corners[two], -p[two])
    total[two] += below
    moment[two] += below_moment
    into = -0.5 * cross  # area times the normal into the probe
    force = total[:, None] * into
    torque = np.cross(moment, into)
    return np.concatenate([force.sum(axis=0), torque.sum(axis=0)])


def _linear(corners: Array, p: Array) -> tuple[Array, Array]:
    """Mean of p and of p x over triangles with linear p, (f,) and (f, 3)."""
    middle = corners.sum(axis=1)
    weighted = np.einsum("fc,fci->fi", p, corners)
    return p.mean(axis=1), (weighted + p.sum(axis=1)[:, None] * middle) / 12.0


def _one_above(corners: Array, p: Array) -> tuple[Array, Array]:
    """As `_linear` for max(p, 0) with one positive corner: over a smaller triangle."""
    rows = np.arange(len(p))
    top = p.argmax(axis=1)
    peak, value = corners[rows, top], p[rows, top]
    share, ends = np.ones(len(p)), [peak]
    for other in (1, 2):
        at = (top + other) % 3
        part = value / (value - p[rows, at])
        ends.append(peak + part[:, None] * (corners[rows, at] - peak))
        share *= part
    zero = np.zeros(len(p))
    mean, moment = _linear(np.stack(ends, 1), np.stack([value, zero, zero], 1))
    return share * mean, share[:, None] * moment

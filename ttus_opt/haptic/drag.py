"""Drag, the friction force on a sliding probe, as a function of pose and twist.

A pose is (R, x); a twist (v, ω) is the velocity of the probe frame's origin and the
angular velocity, patient axes. The contact patch (docs/method/friction.md) has
the normal n̂ and the centre c, means over the points in contact weighted by area and
depth. Drag acts at x₀ + a, perpendicular to ê: either on the patch (a = c, ê = n̂), or
at the reference point x₀, where ê is the probe's pressing axis (a = 0, ê = R·axis).
With f the contact force, sliding velocity and drag are

    u = v + ω × (R x₀ + a),   v_t = u − ê (êᵀu)
    f_d = −(μ max(n̂ᵀf, 0) / max(‖v_t‖, v₀) + c_region) v_t,   τ_d = a × f_d

Instead of the term in μ, Coulomb drag may act at every point of the shell
(`ttus_opt.haptic.point_drag`), or hold a probe at rest (`ttus_opt.haptic.presliding`);
viscous drag always acts on the patch.

The power is f_dᵀu = −k ‖v_t‖² with k ≥ 0: drag only dissipates energy, for any pose,
twist and field. To ensure this, a contact that pulls (n̂ᵀf < 0) has no drag, and
negative coefficients are refused. Where nothing pulls, this is the drag of the fit's
rows (`friction.coulomb_rows`, `viscous_rows`).
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ttus_opt.contact import friction
from ttus_opt.contact.rows import rotated, shell_arrays
from ttus_opt.core.arguments import expect_not_negative, expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.compiled import compiled
from ttus_opt.core.errors import InputError
from ttus_opt.probe.cylindrical import TURN, turn_angle
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.voxmap.grid import CylindricalGrid

#: Indices in `DragLaw.numbers`: 1 if there is drag, `BY_PATCH` if any is on the patch;
#: μ [–]; v₀ [m/s]; where it acts; the pressing axis; sectors and bands; lowest height
#: and length of the grid [m]; ℓ of `ttus_opt.haptic.presliding`, 0 for none [m]; then c
#: of every region, sector by sector [N·s/m]
ACTIVE, FRICTION, DEADBAND, ACTS_AT, AXIS = 0, 1, 2, 3, 4
SECTORS, BANDS, LOWEST, LENGTH, PRESLIDING, VISCOUS = 7, 8, 9, 10, 11, 12

#: Value of `ACTIVE` if any drag acts on the patch
BY_PATCH = 2.0

#: Values of `ACTS_AT`; 0 is on the patch
AT_REFERENCE, AT_POINTS = 1.0, 2.0


@dataclass(frozen=True)
class DragLaw:
    """The drag parameters of a field.

    Attributes:
        numbers: For compiled loops, by the indices above, (VISCOUS + n_regions,).
    """

    numbers: Array = field(repr=False)

    @property
    def active(self) -> bool:
        """Whether the field exerts any drag on a moving probe."""
        return bool(self.numbers[ACTIVE])

    @classmethod
    def of(cls, parameters: Mapping[str, float], grid: CylindricalGrid) -> DragLaw:
        """Read a field's parameters.

        Args:
            parameters: ``friction_coefficient`` [–], ``viscous_coefficient`` [N·s/m]
                with ``viscous_sectors``, ``viscous_bands`` and one
                ``viscous_coefficient_<i>`` for each region where they are regional,
                ``drag_deadband`` [m/s], ``presliding_length`` (0 for none) [m],
                ``drag_at_points`` and ``drag_at_reference`` (1 or 0) and
                ``drag_axis_x, _y, _z``.
            grid: Grid of the field, along which bands are counted.

        Raises:
            InputError: A coefficient that is negative or not finite, a deadband that
                is not positive, drag at the reference without a unit axis, a flag
                other than 0 and 1, or no region.
        """
        numbers = np.zeros(VISCOUS)
        numbers[FRICTION] = _coefficient(parameters, friction.FRICTION, 0.0)
        numbers[DEADBAND] = parameters.get(friction.DRAG_DEADBAND, friction.DEADBAND)
        as_tool = _flag(parameters, friction.DRAG_AT_REFERENCE)
        numbers[ACTS_AT] = AT_REFERENCE if as_tool else 0.0
        if _flag(parameters, friction.DRAG_AT_POINTS):
            if as_tool:
                raise InputError(
                    "drag acts at the reference or at every point: a field cannot have "
                    f"both {friction.DRAG_AT_REFERENCE} and {friction.DRAG_AT_POINTS}"
                )
            numbers[ACTS_AT] = AT_POINTS
        numbers[PRESLIDING] = _coefficient(parameters, friction.PRESLIDING, 0.0)
        counts = [int(parameters.get(n, 1)) for n in (friction.SECTORS, friction.BANDS)]
        numbers[SECTORS], numbers[BANDS] = counts
        numbers[LOWEST], numbers[LENGTH] = grid.z_min, grid.z_max - grid.z_min
        if min(counts) < 1:
            raise InputError(
                f"viscous drag needs at least one sector and one band, got {counts}"
            )
        mean = _coefficient(parameters, friction.VISCOUS, 0.0)
        viscosity = [
            _coefficient(parameters, f"{friction.VISCOUS}_{i}", mean)
            for i in range(counts[0] * counts[1])
        ]
        by_points = numbers[ACTS_AT] == AT_POINTS and numbers[PRESLIDING] == 0.0
        if max(viscosity) > 0.0 or (numbers[FRICTION] > 0.0 and not by_points):
            numbers[ACTIVE] = BY_PATCH
        elif numbers[FRICTION] > 0.0:
            numbers[ACTIVE] = 1.0
        expect_positive(float(numbers[DEADBAND]), friction.DRAG_DEADBAND, "m/s")
        if as_tool:
            numbers[AXIS : AXIS + 3] = _axis(parameters)
        return cls(np.concatenate([numbers, viscosity]))


def _coefficient(parameters: Mapping[str, float], name: str, other: float) -> float:
    value = float(parameters.get(name, other))
    expect_not_negative(value, f"{name} of a field")
    return value


def _flag(parameters: Mapping[str, float], name: str) -> bool:
    value = float(parameters.get(name, 0.0))
    if value not in (0.0, 1.0):
        raise InputError(f"{name} of a field must be 0 or 1, got {value:g}")
    return value == 1.0


def _axis(parameters: Mapping[str, float]) -> Array:
    """The pressing axis in the probe frame: of unit length, or zero when unknown."""
    if not all(name in parameters for name in friction.DRAG_AXIS):
        raise InputError(
            "drag at the reference needs the axis along which the probe presses: give "
            f"{', '.join(friction.DRAG_AXIS)} among the field's parameters"
        )
    axis = np.array([float(parameters[name]) for name in friction.DRAG_AXIS])
    if axis.any() and not abs(float(axis @ axis) - 1.0) < 1e-9:
        raise InputError(f"the drag axis must have unit length, got {axis.tolist()}")
    return axis


def patch_weights(shell: PointShell) -> Array:
    """Contribution of each point to the patch per metre of depth, shape (M, 7).

    Area over A₀ times normal and lever arm [m], probe frame, then that area.
    """
    points, normals, areas, reference = shell_arrays(shell)
    columns = [areas[:, None] * normals, areas[:, None] * (points - reference)]
    return np.concatenate([*columns, areas[:, None]], axis=1)


@compiled(error_model="numpy", nogil=True)
def patch_of(
    R: Array,
    contact: int,
    touched: NDArray[np.int64],
    depth: Array,
    weights: Array,
    patch: Array,
) -> None:
    """The patch of the points in contact (compiled).

    Args:
        R: Rotation, probe to patient, shape (3, 3) [–].
        contact: Number of points in contact.
        touched: Their indices, shape (M,).
        depth: Their depths below the surface, shape (M,) [m].
        weights: `patch_weights`, in block order, shape (M, 7).
        patch: Out: n̂ [–] and c [m], patient axes; zero without contact; shape (6,).
    """
    nx, ny, nz, cx, cy, cz, total = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(contact):
        d, m = depth[i], touched[i]
        nx += d * weights[m, 0]
        ny += d * weights[m, 1]
        nz += d * weights[m, 2]
        cx += d * weights[m, 3]
        cy += d * weights[m, 4]
        cz += d * weights[m, 5]
        total += d * weights[m, 6]
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if total == 0.0 or length == 0.0:
        for i in range(6):
            patch[i] = 0.0
        return
    patch[0], patch[1], patch[2] = rotated(R, nx / length, ny / length, nz / length)
    patch[3], patch[4], patch[5] = rotated(R, cx / total, cy / total, cz / total)


@compiled(error_model="numpy", nogil=True)
def drag_of(
    R: Array,
    at: Array,
    twist: Array,
    reference: Array,
    patch: Array,
    contact_wrench: Array,
    numbers: Array,
    drag: Array,
) -> None:
    """The drag of one pose and twist (compiled).

    Args:
        R: Rotation, probe to patient, shape (3, 3) [–].
        at: Position of the probe frame's origin, shape (3,) [m].
        twist: Velocity of the origin and angular velocity, shape (6,) [m/s, rad/s].
        reference: Reference point of the shell, probe frame, shape (3,) [m].
        patch: `patch_of`, shape (6,).
        contact_wrench: Wrench of the field without drag, shape (6,) [N, N·m].
        numbers: `DragLaw.numbers` of the field.
        drag: Out: force and torque about the reference point, shape (6,) [N, N·m].
    """
    nx, ny, nz = patch[0], patch[1], patch[2]
    for i in range(6):
        drag[i] = 0.0
    if numbers[ACTIVE] == 0.0 or (nx == 0.0 and ny == 0.0 and nz == 0.0):
        return
    x, y, z = rotated(R, reference[0], reference[1], reference[2])
    ax, ay, az, ex, ey, ez = patch[3], patch[4], patch[5], nx, ny, nz
    if numbers[ACTS_AT] == AT_REFERENCE:
        ax, ay, az = 0.0, 0.0, 0.0
        ex, ey, ez = rotated(R, numbers[AXIS], numbers[AXIS + 1], numbers[AXIS + 2])
    lx, ly, lz = x + ax, y + ay, z + az
    ux = twist[0] + (twist[4] * lz - twist[5] * ly)
    uy = twist[1] + (twist[5] * lx - twist[3] * lz)
    uz = twist[2] + (twist[3] * ly - twist[4] * lx)
    along = ex * ux + ey * uy + ez * uz
    ux, uy, uz = ux - along * ex, uy - along * ey, uz - along * ez
    speed = math.sqrt(ux * ux + uy * uy + uz * uz)
    f = contact_wrench
    pressed = max(nx * f[0] + ny * f[1] + nz * f[2], 0.0)
    elsewhere = numbers[ACTS_AT] == AT_POINTS or numbers[PRESLIDING] > 0.0
    friction = 0.0 if elsewhere else numbers[FRICTION]
    k = friction * pressed / max(speed, numbers[DEADBAND])
    place = at[0] + x + patch[3], at[1] + y + patch[4], at[2] + z + patch[5]
    k += numbers[VISCOUS + _region(place[0], place[1], place[2], numbers)]
    fx, fy, fz = -k * ux, -k * uy, -k * uz
    drag[0], drag[1], drag[2] = fx, fy, fz
    drag[3], drag[4], drag[5] = (
        ay * fz - az * fy,
        az * fx - ax * fz,
        ax * fy - ay * fx,
    )


@compiled(inline="always")
def _region(x: float, y: float, z: float, numbers: Array) -> int:
    """Index of the region at a point, as in `friction.Sliding.regions` (compiled)."""
    sectors, bands = int(numbers[SECTORS]), int(numbers[BANDS])
    share = (z - numbers[LOWEST]) / numbers[LENGTH]
    band = int(min(max(share * bands, 0.0), bands - 1.0))
    sector = min(int(turn_angle(x, y) * sectors / TURN), sectors - 1)
    return sector * bands + band

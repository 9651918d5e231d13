"""Coulomb drag of every point of the probe for itself, in one pose.

With w_m p(x_m) n̂_m the contact force of point m, r_m its lever from the shell's
reference and v_m its velocity across n̂_m, `ttus_opt.contact.point_drag`,

    f_d = −Σ_m k_m v_m,   τ_d = −Σ_m k_m (r_m × v_m),
    k_m = μ w_m max(p(x_m), 0) / max(‖v_m‖, v₀).

Its power is −Σ k_m v_mᵀu_m = −Σ k_m ‖v_m‖² with k_m ≥ 0, u_m the point's velocity: it
takes energy and never gives any, whatever pose, twist and field. Where no point pulls,
it is that of the fit's rows.
"""

from __future__ import annotations

import math

from ttus_opt.contact.rows import rotated
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.compiled import compiled
from ttus_opt.haptic.drag import DEADBAND, FRICTION
from ttus_opt.haptic.frame import LENGTH
from ttus_opt.haptic.kernel_data import FrameData


@compiled(inline="always")
def _turned_back(R: Array, x: float, y: float, z: float) -> tuple[float, float, float]:
    """Rᵀ times a vector (compiled)."""
    return (
        R[0, 0] * x + R[1, 0] * y + R[2, 0] * z,
        R[0, 1] * x + R[1, 1] * y + R[2, 1] * z,
        R[0, 2] * x + R[1, 2] * y + R[2, 2] * z,
    )


@compiled(error_model="numpy", nogil=True, apart=True)
def _slide(
    touched: IntArray,
    sampled: Array,
    points: Array,
    lever: Array,
    reference: tuple[float, float, float],
    motion: tuple[float, float, float, float, float, float],
    slow: float,
    place: Array,
) -> None:
    """What points push against their sliding, without a branch (compiled).

    Args:
        touched: The points, shape (n,).
        sampled: What each samples of the field, shape (n,).
        points: Of the probe, shape (3, M) [m].
        lever: `FrameData.lever`.
        reference: Of the shell [m].
        motion: Velocity of the reference and angular velocity, probe axes.
        slow: Square of the deadband [m²/s²].
        place: `FrameData.place`, written: levers [m] and forces over μ, the first six
            rows.
    """
    vx, vy, vz, wx, wy, wz = motion
    xs, ys, zs = points[0], points[1], points[2]
    out_x, out_y, out_z = place[0], place[1], place[2]
    force_x, force_y, force_z = place[3], place[4], place[5]
    for c in range(touched.size):
        m, p = touched[c], max(sampled[c], 0.0)
        a, b, d = lever[m, 0], lever[m, 1], lever[m, 2]
        lx, ly, lz = xs[m] - reference[0], ys[m] - reference[1], zs[m] - reference[2]
        ux = vx + (wy * lz - wz * ly)
        uy = vy + (wz * lx - wx * lz)
        uz = vz + (wx * ly - wy * lx)
        square = a * a + b * b + d * d  # the normal is as long as the weight
        along = (a * ux + b * uy + d * uz) / square
        ux, uy, uz = ux - along * a, uy - along * b, uz - along * d
        k = p * math.sqrt(square / max(ux * ux + uy * uy + uz * uz, slow))
        out_x[c], out_y[c], out_z[c] = lx, ly, lz
        force_x[c], force_y[c], force_z[c] = k * ux, k * uy, k * uz


@compiled(error_model="numpy", nogil=True)
def add_point_drag(
    R: Array, twist: Array, contact: int, s: FrameData, numbers: Array, drag: Array
) -> None:
    """Add the drag of the field that `frame.wrench_of` sampled last (compiled).

    Args:
        R: Rotation, probe to patient, shape (3, 3) [–].
        twist: Velocity of the probe frame's origin and angular velocity, patient
            axes, shape (6,) [m/s, rad/s].
        contact: What `frame.touch` returned.
        s: The data of both.
        numbers: `DragLaw.numbers` of the field.
        drag: Force and torque about the reference, patient axes, shape (6,) [N, N·m].
    """
    touched, lever, points, sampled = s.touched, s.lever, s.points, s.sampled
    place = s.place
    x, y, z = s.reference[0], s.reference[1], s.reference[2]
    vx, vy, vz = _turned_back(R, twist[0], twist[1], twist[2])
    wx, wy, wz = _turned_back(R, twist[3], twist[4], twist[5])
    vx, vy, vz = vx + (wy * z - wz * y), vy + (wz * x - wx * z), vz + (wx * y - wy * x)
    motion, slow = (vx, vy, vz, wx, wy, wz), numbers[DEADBAND] * numbers[DEADBAND]
    fx, fy, fz, tx, ty, tz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    first, room = 0, place.shape[1]
    while first < contact:
        last = min(first + room, contact)
        some, values = touched[first:last], sampled[first:last]
        _slide(some, values, points, lever, (x, y, z), motion, slow, place)
        for c in range(last - first):
            lx, ly, lz = place[0, c], place[1, c], place[2, c]
            gx, gy, gz = place[3, c], place[4, c], place[5, c]
            fx, fy, fz = fx + gx, fy + gy, fz + gz
            tx += ly * gz - lz * gy
            ty += lz * gx - lx * gz
            tz += lx * gy - ly * gx
        first = last
    mu = numbers[FRICTION]
    if s.limits[LENGTH] > 0.0:
        mu *= s.share[0]
    fx, fy, fz = rotated(R, fx, fy, fz)
    tx, ty, tz = rotated(R, tx, ty, tz)
    drag[0], drag[1], drag[2] = drag[0] - mu * fx, drag[1] - mu * fy, drag[2] - mu * fz
    drag[3], drag[4], drag[5] = drag[3] - mu * tx, drag[4] - mu * ty, drag[5] - mu * tz

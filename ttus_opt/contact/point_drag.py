"""Coulomb drag of every point of the probe for itself, linear in the field.

A probe that is pressed straight in slides nowhere on the whole, yet the skin slides
along its flanks, and drag there resists the press and its release. So every shell point
in contact drags by its own normal force, against its own sliding:

    f_d = −μ Σ_m w_m p(x_m) t̂_m,   τ_d = −μ Σ_m w_m p(x_m) (r_m × t̂_m)
    u_m = v₀ + ω × r_m,   v_m = u_m − n̂_m (n̂_mᵀ u_m),   t̂_m = v_m / max(‖v_m‖, v_d)

with v₀ the velocity of the shell's reference, r_m the lever from there, w_m n̂_m p(x_m)
the point's contact force (`ttus_opt.contact.rows`) and v_d the deadband. These are the
rows of contact with t̂_m in place of n̂_m. Over a flat patch that does not turn all t̂_m
are one, and this is the drag of the patch (`ttus_opt.contact.friction`).
"""

from __future__ import annotations

from ttus_opt.contact.friction import DEADBAND, DragRows
from ttus_opt.contact.rows import contact_rows
from ttus_opt.contact.slip import Slip
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.voxmap.voxmap import Voxmap


def point_drag_rows(
    voxmap: Voxmap,
    shell: PointShell,
    trajectory: Trajectory,
    *,
    sampling: str = "trilinear",
    deadband: float = DEADBAND,
) -> DragRows:
    """Coulomb drag of a field, point by point: F with drag = −F (μ p).

    Args:
        voxmap: Grid and surface.
        shell: The probe.
        trajectory: Poses over time, which give the velocity.
        sampling: Of the field.
        deadband: Points that slide slower are on their way to rest [m/s].

    Returns:
        Rows over the voxels, shape (3T, V).

    Raises:
        InputError: Unknown sampling or unusable poses.
    """
    rows = contact_rows(
        voxmap,
        shell,
        trajectory.rotation,
        trajectory.position,
        sampling=sampling,
        slip=Slip.of(shell, trajectory.rotation, trajectory.twist(), deadband),
    )
    return DragRows(rows.N, rows.W)

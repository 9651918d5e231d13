"""The bundled example: a simulated torso's scan, true surface and pressed probe.

It comes from `ttus_opt.phantom` (``python -m ttus_opt.phantom`` makes it again), which
knows nothing of potential fields. Trajectories are in the patient frame of
``surface.nc``, whose axis says where that frame lies in ``scan.ply``:
x_scan = axis.rotation · x_patient + axis.origin.
"""

from __future__ import annotations

from pathlib import Path

from ttus_opt.core.errors import InputError

__all__ = ["DRAG", "NAMES", "PROBE", "path"]

#: The probe, as every command takes it: an ellipsoid's semi-axes [m].
PROBE = "ellipsoid:0.030,0.0125,0.018"

#: Coulomb coefficient of the two ``sweep_drag`` recordings [–].
DRAG = 0.25

#: What is in the folder, with what it is.
NAMES = {
    "scan.ply": "cloud of the torso on a table, seen by two depth cameras [m]",
    "surface.nc": "the torso's true surface and its frame in the scan",
    "press_fit.csv": "pushes with lift-offs, without friction, to fit to",
    "press_test.csv": "other pushes, to judge by",
    "sweep_fit.csv": "lines along the body, without friction, to fit to",
    "sweep_test.csv": "other lines, to judge by",
    "sweep_drag_fit.csv": "lines along the body, Coulomb drag 0.25, to fit to",
    "sweep_drag_test.csv": "other lines with the same drag, to judge by",
    "skin.npz": "compliance of the torso's skin on a coarser mesh, to press live",
}


def path(name: str) -> Path:
    """Where a file of the example is.

    Args:
        name: One of `NAMES`.

    Returns:
        Its path.

    Raises:
        InputError: There is no such file.

    Examples:
        >>> path("surface.nc").name
        'surface.nc'
    """
    if name not in NAMES:
        raise InputError(
            f"the example has no {name!r}: choose one of {', '.join(NAMES)}"
        )
    return Path(__file__).parent / name

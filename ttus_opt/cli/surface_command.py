"""``ttus-opt surface``: from a scan to the skin r = R(θ, z)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import typer

from ttus_opt.cli.console import Stages, print_json
from ttus_opt.cli.options import Force, Json, check_outputs, numbers
from ttus_opt.errors import GeometryError, InputError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ttus_opt.scan.frame import Axis
    from ttus_opt.scan.surface import Surface

EXAMPLE = "ttus-opt surface scan.pcd --unit m -o surface.nc --picture surface.png"


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("surface", epilog=f"Example: {EXAMPLE}")(surface)


def surface(
    scan: Annotated[Path, typer.Argument(help="Cloud: PLY, PCD, XYZ, CSV or NPY.")],
    output: Annotated[Path, typer.Option("-o", "--output", help="Surface file (.nc).")],
    unit: Annotated[
        str, typer.Option(help="Unit of the scan's coordinates: m, cm, mm.")
    ] = "m",
    n_theta: Annotated[int, typer.Option(help="Spokes over the full turn.")] = 180,
    n_z: Annotated[int, typer.Option(help="Slices along the body.")] = 60,
    z_range: Annotated[
        str | None,
        typer.Option(help="First and last height in the patient frame, a,b [m]."),
    ] = None,
    axis_origin: Annotated[
        str | None,
        typer.Option(help="A point inside the body, x,y,z in the scan [m]."),
    ] = None,
    axis_direction: Annotated[
        str | None,
        typer.Option(help="Along the body, x,y,z in the scan; with --axis-origin."),
    ] = None,
    axis_from: Annotated[
        Path | None,
        typer.Option(help="Take the patient frame of this surface file."),
    ] = None,
    support: Annotated[
        bool,
        typer.Option(
            "--support/--no-support",
            help="Find the plane the body lies on and leave it out.",
        ),
    ] = True,
    drop_nan: Annotated[
        bool, typer.Option("--drop-nan", help="Leave out points that are NaN.")
    ] = False,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the surface and its observed part here.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Extract the patient's skin from a depth scan."""
    from ttus_opt.scan.cloud import read_cloud
    from ttus_opt.scan.extraction import extract_surface

    if picture is not None:
        from ttus_opt.report import plots

        plots.require_picture_suffix(picture)
    inputs = [scan] if axis_from is None else [scan, axis_from]
    check_outputs([output, picture], inputs, force=force)
    with Stages(3 if picture is None else 4) as begin:
        begin("reading the scan")
        cloud = read_cloud(scan, unit=unit, drop_nan=drop_nan)  # type: ignore[arg-type]
        frame = _axis(cloud, axis_origin, axis_direction, axis_from)
        begin("following the contour")
        found = extract_surface(
            cloud,
            axis=frame,
            n_theta=n_theta,
            n_z=n_z,
            z_range=None if z_range is None else _pair(z_range),
            support="find" if support else None,
        )
        begin("writing the surface")
        found.save(output)
        if picture is not None:
            begin("drawing")
            plots.save_picture(plots.surface_picture(found, cloud), picture)
    told = _summary(found, len(cloud), output)
    if json:
        print_json(told)
        return
    typer.echo(
        f"{output}: {n_theta} x {n_z} radii, {100 * told['observed']:.0f} % observed, "
        f"R {100 * told['radius_min_m']:.1f} to {100 * told['radius_max_m']:.1f} cm, "
        f"z {100 * told['z_min_m']:.1f} to {100 * told['z_max_m']:.1f} cm"
    )


def _pair(text: str) -> tuple[float, float]:
    low, high = numbers(text, 2, "--z-range")
    return low, high


def _axis(
    cloud: NDArray[np.float64],
    origin: str | None,
    direction: str | None,
    file: Path | None,
) -> Axis:
    """The patient frame: from a file, from origin and direction, or estimated."""
    from ttus_opt.scan.frame import Axis
    from ttus_opt.scan.surface import Surface

    if file is not None:
        if origin is not None or direction is not None:
            raise InputError("give either --axis-from or --axis-origin, not both")
        return Surface.load(file).axis
    if origin is None and direction is None:
        return Axis.from_cloud(cloud)
    if origin is None or direction is None:
        raise InputError("--axis-origin and --axis-direction go together: give both")
    z = np.array(numbers(direction, 3, "--axis-direction"))
    length = float(np.linalg.norm(z))
    if not (np.isfinite(length) and length > 0):
        raise GeometryError(
            f"--axis-direction must not be zero, got {direction}: for instance 0,0,1"
        )
    z /= length
    # x: the scan's axis that stands across the body most squarely
    nearest = np.eye(3)[int(np.argmin(np.abs(z)))]
    x = nearest - (nearest @ z) * z
    x /= np.linalg.norm(x)
    at = np.array(numbers(origin, 3, "--axis-origin"))
    return Axis(at, np.stack([x, np.cross(z, x), z], axis=1))


def _summary(found: Surface, n_points: int, output: Path) -> dict[str, Any]:
    return {
        "output": str(output),
        "points": n_points,
        "n_theta": len(found.theta),
        "n_z": len(found.z),
        "observed": float(found.observed.mean()),
        "radius_min_m": float(found.radius.min()),
        "radius_max_m": float(found.radius.max()),
        "z_min_m": float(found.z[0]),
        "z_max_m": float(found.z[-1]),
        "axis_origin": found.axis.origin.tolist(),
        "axis_rotation": found.axis.rotation.tolist(),
    }

"""``ttus-opt surface``: from a scan to the skin r = R(θ, z)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.cloud_options import AxisOptions, CloudOptions
from ttus_opt.cli.console import Stages, print_json
from ttus_opt.cli.depth_options import DepthOptions, stitched_facts, stitched_lines
from ttus_opt.cli.option_groups import grouped
from ttus_opt.cli.options import Force, Json, check_outputs, numbers

if TYPE_CHECKING:
    from ttus_opt.arrays import Array
    from ttus_opt.scan.surface import Surface
    from ttus_opt.sensors.stitching import Stitched

EXAMPLE = (
    "ttus-opt surface scan.pcd --unit m --box -0.5,0.5,-0.6,0.6,0.5,1.5 "
    "-o surface.nc --picture surface.png; of depth images: ttus-opt surface front.png "
    "left.png --intrinsics camera.json --poses poses.csv --noise stereo:0.05 --refine "
    "-o surface.nc"
)


def register(app: typer.Typer) -> None:
    """Add the command."""
    app.command("surface", epilog=f"Example: {EXAMPLE}")(grouped(surface))


def surface(
    cloud: CloudOptions,
    depth: DepthOptions,
    axis: AxisOptions,
    output: Annotated[Path, typer.Option("-o", "--output", help="Surface file (.nc).")],
    n_theta: Annotated[int, typer.Option(help="Spokes over the full turn.")] = 180,
    n_z: Annotated[int, typer.Option(help="Slices along the body.")] = 60,
    z_range: Annotated[
        str | None,
        typer.Option(help="First and last height in the patient frame, a,b [m]."),
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Draw the surface and its observed part here.")
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Extract the patient's skin from a depth scan.

    The patient's frame, which recordings and fields share, has x to the right, y to the
    front and z to the head; the surface file says where it lies in the scan.
    """
    from ttus_opt.scan.extraction import extract_surface

    if picture is not None:
        from ttus_opt.report import plots

        plots.require_picture_suffix(picture)
    inputs = [*cloud.scans, *depth.files, *([axis.axis_from] if axis.axis_from else [])]
    check_outputs([output, picture], inputs, force=force)
    with Stages(3 if picture is None else 4) as begin:
        begin("reading the scan")
        points, std, stitched = _read(cloud, depth)
        frame = axis.frame(points)
        begin("following the contour")
        found = extract_surface(
            points,
            axis=frame,
            n_theta=n_theta,
            n_z=n_z,
            z_range=None if z_range is None else _pair(z_range),
            support="find" if axis.support else None,
            point_std=std,
        )
        begin("writing the surface")
        found.save(output)
        if picture is not None:
            begin("drawing")
            plots.save_picture(plots.surface_picture(found, points), picture)
    told = _summary(found, len(points), output)
    if stitched is not None:
        told |= stitched_facts(stitched)
    if json:
        print_json(told)
        return
    typer.echo(
        f"{output}: {n_theta} x {n_z} radii, {100 * told['observed']:.0f} % observed, "
        f"R {100 * told['radius_min_m']:.1f} to {100 * told['radius_max_m']:.1f} cm, "
        f"z {100 * told['z_min_m']:.1f} to {100 * told['z_max_m']:.1f} cm"
    )
    for line in [] if stitched is None else stitched_lines(stitched):
        typer.echo(line)
    along = ", ".join(f"{v:.2f}" for v in frame.rotation[:, 2])
    guess = " by the depth of the trunk: if not, add --flip-axis"
    typer.echo(
        "patient frame: x right, y front, z head; the head lies towards "
        f"({along}) in the scan" + (guess if axis.guesses else "")
    )


def _read(
    cloud: CloudOptions, depth: DepthOptions
) -> tuple[Array, Array | None, Stitched | None]:
    """Points (n, 3) [m], their deviations, and what depth images they are from."""
    if not depth.are_given(cloud.scans):
        return cloud.read(), None, None
    found = depth.read(cloud)
    points, std = found.cloud.points, found.cloud.std
    if cloud.limits is not None:
        from ttus_opt.scan.box import inside

        kept = inside(points, cloud.limits)
        points, std = points[kept], None if std is None else std[kept]
    return points, std, found


def _pair(text: str) -> tuple[float, float]:
    low, high = numbers(text, 2, "--z-range")
    return low, high


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

"""``ttus-opt surface``: from a scan to the surface r = R(θ, z)."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.cli.cloud_options import AxisOptions, CloudOptions
from ttus_opt.cli.console import Stages, tell
from ttus_opt.cli.depth_options import DepthOptions, stitched_facts, stitched_lines
from ttus_opt.cli.options import numbers
from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    from ttus_opt.core.arrays import Array
    from ttus_opt.scan.surface import Surface
    from ttus_opt.sensors.stitching import Stitched


def surface(
    cloud: CloudOptions,
    depth: DepthOptions,
    axis: AxisOptions,
    output: Path,
    n_theta: int = 180,
    n_z: int = 60,
    z_range: str | None = None,
    update: Path | None = None,
    picture: Path | None = None,
) -> None:
    """Extract the patient's surface from a depth scan.

    Recordings and fields use the patient's frame: x to the right, y to the front, z to
    the head. The surface file stores where it lies in the scan.

    Args:
        output: Surface file (.nc).
        n_theta: Number of angles around the body.
        n_z: Number of slices along the body.
        z_range: First and last height in the patient frame, a,b [m].
        update: Update this surface file with the scan. Its frame and grid stay, and so
            do the parts that the scan does not see.
        picture: Draw the surface here, with its observed part tinted.

    Example:
        ttus-opt surface scan.pcd --unit m --box -0.5,0.5,-0.6,0.6,0.5,1.5 -o surface.nc
        --picture surface.png; of depth images: ttus-opt surface front.png left.png
        --intrinsics camera.json --poses poses.csv --noise stereo:0.05 --refine -o
        surface.nc
    """
    from ttus_opt.scan.extraction import extract_surface

    heights = None if z_range is None else numbers(z_range, 2, "--z-range")
    with Stages(3 if picture is None else 4) as begin:
        begin("reading the scan")
        points, std, stitched = _read(cloud, depth)
        begin("following the contour")
        changes: dict[str, Any] = {}
        if update is None:
            found = extract_surface(
                points,
                axis=axis.frame(points, stitched.seen_from if stitched else None),
                n_theta=n_theta,
                n_z=n_z,
                z_range=heights,  # type: ignore[arg-type]  # two of them
                support="find" if axis.support else None,
                point_std=std,
            )
        else:
            found, changes = _updated(points, std, axis, update)
        begin("writing the surface")
        found.save(output)
        if picture is not None:
            from ttus_opt.report import plots

            begin("drawing")
            plots.save_picture(plots.surface_picture(found, points), picture)
    facts = _summary(found, len(points), output) | changes
    if stitched is not None:
        facts |= stitched_facts(stitched)
    lines = [
        f"{output}: {facts['n_theta']} x {facts['n_z']} radii, "
        f"{100 * facts['observed']:.0f} % observed, "
        f"R {100 * facts['radius_min_m']:.1f} to {100 * facts['radius_max_m']:.1f} cm, "
        f"z {100 * facts['z_min_m']:.1f} to {100 * facts['z_max_m']:.1f} cm",
        *_deviations(facts),
    ]
    if changes:
        shares = ", ".join(
            f"{name} {100 * changes[name]:.0f} %"
            for name in ("kept", "averaged", "replaced", "added")
        )
        lines.append(f"of its nodes: {shares}")
    if stitched is not None:
        lines += stitched_lines(stitched)
    along = ", ".join(f"{v:.2f}" for v in found.axis.rotation[:, 2])
    guess = " by the depth of the trunk: if not, add --flip-axis"
    lines.append(
        "patient frame: x right, y front, z head; the head lies towards "
        f"({along}) in the scan" + (guess if axis.guesses and update is None else "")
    )
    tell(facts, *lines)


def _updated(
    points: Array, std: Array | None, axis: AxisOptions, update: Path
) -> tuple[Surface, dict[str, Any]]:
    """The surface of a file updated by a scan, and what became of its nodes."""
    from ttus_opt.scan.surface import Surface
    from ttus_opt.scan.update import update_surface

    if axis.are_given:
        raise InputError(
            "--update keeps the surface's frame: leave --axis-…, --head, --flip-axis "
            "and --prone out"
        )
    found = update_surface(
        Surface.load(update),
        points,
        point_std=std,
        support="find" if axis.support else None,
    )
    return found.surface, {
        "kept": found.kept,
        "averaged": found.averaged,
        "replaced": found.replaced,
        "added": found.added,
        "difference_m": found.difference,
    }


def _read(
    cloud: CloudOptions, depth: DepthOptions
) -> tuple[Array, Array | None, Stitched | None]:
    """Points (n, 3) [m], their deviations, and what depth images they are from."""
    if not depth.are_given(cloud.scans):
        return cloud.read(), None, None
    found = depth.read(cloud)
    seen = found.cloud.of_patient(cloud.scans[0].name, cloud.limits)
    return seen.points, seen.std, found


def _deviations(facts: dict[str, Any]) -> list[str]:
    """A line of the filled part's standard deviations; none where all was seen."""
    if facts["std_filled_m"] is None:
        return []
    seen, filled, most = (
        1e3 * facts[f"std_{name}_m"] for name in ("observed", "filled", "largest")
    )
    return [
        f"standard deviation of R: {seen:.1f} mm where observed, {filled:.0f} mm where "
        f"filled (medians), at most {most:.0f} mm"
    ]


def _summary(found: Surface, n_points: int, output: Path) -> dict[str, Any]:
    from numpy import median

    seen, std = found.observed, found.radius_std
    return {
        "output": str(output),
        "points": n_points,
        "n_theta": len(found.theta),
        "n_z": len(found.z),
        "observed": float(found.observed.mean()),
        "std_observed_m": float(median(std[seen])) if seen.any() else None,
        "std_filled_m": None if seen.all() else float(median(std[~seen])),
        "std_largest_m": float(std.max()),
        "radius_min_m": float(found.radius.min()),
        "radius_max_m": float(found.radius.max()),
        "z_min_m": float(found.z[0]),
        "z_max_m": float(found.z[-1]),
        "axis_origin": found.axis.origin.tolist(),
        "axis_rotation": found.axis.rotation.tolist(),
    }

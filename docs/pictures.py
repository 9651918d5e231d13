"""Draws the documentation's pictures into docs/pictures; `make docs` calls it.

The demo's own, two of the method (the voxmap and the sampling below the surface), one
each of recordings and of a depth image, and the rooms of the package.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import grimp
import numpy as np

import ttus_opt as tt
from ttus_opt import example, plots
from ttus_opt.fitting.weights.weight_choice import default_model
from ttus_opt.report.plots.canvas import AFTER, BEFORE, MEASURED, look, new_figure
from ttus_opt.sensors.depth import DepthImage
from ttus_opt.sensors.depth_noise import noise_model
from ttus_opt.sensors.intrinsics import Intrinsics
from ttus_opt.sensors.unprojection import Unprojection
from ttus_opt.session import demo

FOLDER = Path(__file__).parent / "pictures"


def voxmap_picture(path: Path) -> None:
    """A section of a coarse voxmap with the surface."""
    surface = tt.Surface.load(example.path("surface.nc"))
    voxmap = tt.Voxmap.from_surface(surface, shape=(14, 48, 9), r_inner=0.06)
    grid, k = voxmap.grid, 4
    fine = np.linspace(0.0, 2.0 * np.pi, 721)
    with look():
        figure = new_figure(7.0, 3.4)
        axes = figure.subplots()
        radius, angle = np.meshgrid(grid.r, grid.theta, indexing="ij")
        layer = voxmap.region[:, :, k]
        for value, colour, name in (
            (1, "#0b4f9c", "inside, p > 0"),
            (0, "k", "surface layer, p = 0"),
            (-1, "0.7", "outside, p < 0"),
        ):
            at = layer == value
            axes.plot(
                100 * radius[at] * np.cos(angle[at]),
                100 * radius[at] * np.sin(angle[at]),
                ".",
                color=colour,
                markersize=3.5,
                label=name,
            )
        edge = 100 * surface.radius_at(fine, np.full_like(fine, grid.z[k]))
        axes.plot(
            edge * np.cos(fine), edge * np.sin(fine), color="#b8860b", lw=1.2,
            label="surface r = R(θ, z)",
        )  # fmt: skip
        axes.set_aspect("equal")
        axes.set_xlabel("x [cm]")
        axes.set_ylabel("y [cm]")
        axes.legend(loc="center left", bbox_to_anchor=(1.02, 0.5))
        plots.save_picture(figure, path)


def sampling_picture(path: Path) -> None:
    """The field along one spoke, and what a point samples at its depth."""
    layers = np.arange(5.0)
    values = np.array([9.0, 6.5, 4.3, 2.4, 0.0])
    edge, last = 3.7, 3  # in radial steps from the inner layer
    depth = np.linspace(-0.6, edge + 0.8, 400)
    place = np.clip(edge - depth, 0.0, None)
    below = np.interp(place, layers[: last + 1], values[: last + 1])
    above = values[last] * depth / (edge - last)
    sampled = np.where(place > last, above, below)
    with look():
        figure = new_figure(7.0, 2.8)
        axes = figure.subplots()
        inside = depth >= 0.0
        axes.plot(depth[inside], sampled[inside], color=AFTER, label="what is sampled")
        axes.plot(edge - layers[:4], values[:4], "o", color=BEFORE, label="layers")
        axes.plot(edge - 4.0, 0.0, "s", color="k", label="surface layer")
        axes.axvline(0.0, color="#b8860b", lw=1.2)
        axes.annotate("surface", (0.0, 8.3), xytext=(4, 0), textcoords="offset points")
        axes.axvline(edge, color=MEASURED, lw=1.0)
        axes.annotate(
            "inner layer", (edge, 4.0), xytext=(4, 0), textcoords="offset points"
        )
        axes.annotate(
            "a", (edge - last, values[last]), xytext=(5, -9),
            textcoords="offset points",
        )  # fmt: skip
        axes.set_xlabel("depth below the surface d [Δr]")
        axes.set_ylabel("p")
        axes.set_yticks([0])
        axes.legend(loc="lower right")
        plots.save_picture(figure, path)


def poses_picture(path: Path) -> None:
    """Two recordings on the skin, and one with two columns mistaken."""
    press, sweep = (
        tt.read_trajectory(example.path(f"{name}.csv"))
        for name in ("press_fit", "sweep_fit")
    )
    swapped = replace(press, position=press.position[:, [1, 0, 2]])
    figure = plots.pose_picture(
        tt.Surface.load(example.path("surface.nc")),
        tt.PointShell.ellipsoid(semi_axes=(0.030, 0.0125, 0.018)),
        tt.Trajectory.concatenate([press, sweep, swapped]),
        ["presses", "sweeps", "presses, px and py swapped"],
    )
    plots.save_picture(figure, path)


def next_press_picture(path: Path) -> None:
    """Where to press next after a sweep, on the front."""
    surface = tt.Surface.load(example.path("surface.nc"))
    recorded = tt.read_trajectory(example.path("sweep_fit.csv"))
    scene = tt.Scene.assemble(
        tt.Voxmap.from_surface(surface, shape=(24, 72, 30), r_inner=0.03),
        tt.PointShell.ellipsoid(semi_axes=(0.030, 0.0125, 0.018)),
        recorded,
    )
    choice = default_model(scene)
    uncertainty = tt.uncertainty(tt.fit(choice.scene, choice.formulation), choice.scene)
    front = np.radians(30.0), np.radians(150.0)
    found = tt.next_press(uncertainty, sector=front)
    plots.save_picture(plots.next_press_picture(found, recorded), path)


def depth_picture(path: Path) -> None:
    """A depth image of a body on a bed, and its points with their deviations."""
    matrix = np.array([[300.0, 0.0, 159.5], [0.0, 300.0, 119.5], [0.0, 0.0, 1.0]])
    camera = Unprojection.from_intrinsics(Intrinsics(matrix, np.zeros(0)), (240, 320))
    rays = camera.rays / camera.rays[..., 2:]
    # an ellipse of 17 by 11 cm, 0.9 m above a bed that the camera looks down at
    a = (rays[..., 0] / 0.17) ** 2 + (1.0 / 0.11) ** 2
    b, c = -0.79 / 0.11**2, (0.79 / 0.11) ** 2 - 1.0
    room = b**2 - a * c
    z = np.where(room > 0.0, (-b - np.sqrt(np.maximum(room, 0.0))) / a, 0.9)
    model = noise_model("structured-light")
    rng = np.random.default_rng(0)
    noisy = z + 0.0015 * rng.standard_normal(z.shape)
    noisy[rng.random(z.shape) < 0.05] = np.nan
    cloud = DepthImage(noisy, camera).to_cloud(noise=model)
    assert cloud.std is not None
    shown = np.abs(cloud.points[:, 1]) < 0.02
    x, _, depth = 100.0 * cloud.points[shown].T
    with look():
        figure = new_figure(7.4, 2.9)
        left, right = figure.subplots(1, 2, width_ratios=[1.0, 1.2])
        image = left.imshow(100.0 * noisy, cmap="viridis")
        left.set_title("depth image")
        left.set_xlabel("column [pixel]")
        left.set_ylabel("row [pixel]")
        figure.colorbar(image, ax=left, label="z [cm]", shrink=0.8)
        dots = right.scatter(x, depth, c=1e3 * cloud.std[shown], s=1.5, cmap="magma_r")
        right.invert_yaxis()
        right.set_aspect("equal")
        right.set_title("points of a strip, camera above")
        right.set_xlabel("x [cm]")
        right.set_ylabel("z [cm]")
        figure.colorbar(dots, ax=right, label="standard deviation [mm]", shrink=0.8)
        plots.save_picture(figure, path)


def rooms_picture(path: Path) -> None:
    """The rooms of the package, a line per floor, and what imports what.

    An arrow that follows from others is left out.
    """
    graph = grimp.build_graph("ttus_opt", exclude_type_checking_imports=True)
    package = FOLDER.parents[1] / "ttus_opt"
    every = graph.find_children("ttus_opt")
    rooms = {room for room in every if (package / room.split(".")[1]).is_dir()}
    below = {
        room.rpartition(".")[2]: {
            other.rpartition(".")[2]
            for other in rooms - {room}
            if graph.direct_import_exists(
                importer=room, imported=other, as_packages=True
            )
        }
        for room in sorted(rooms)
    }

    def floor(room: str) -> int:
        return 1 + max(map(floor, below[room]), default=-1)

    def reached(room: str) -> set[str]:
        return below[room].union(*map(reached, below[room]))

    floors: dict[int, list[str]] = {}
    for room in sorted(below):
        floors.setdefault(floor(room), []).append(room)
    at = {
        room: (4.0 * (x - (len(here) - 1) / 2) + 0.9 * (-1) ** y, float(y))
        for y, here in floors.items()
        for x, room in enumerate(here)
    }
    with look():
        figure = new_figure(7.0, 6.5)
        axes = figure.subplots()
        for room, others in below.items():
            for other in sorted(others.difference(*map(reached, others))):
                axes.annotate(
                    "", at[other], at[room],
                    arrowprops={"arrowstyle": "->", "color": "0.6", "lw": 0.8},
                )  # fmt: skip
        for room, (x, y) in at.items():
            frame = {"boxstyle": "round", "fc": "w", "ec": "0.3"}
            axes.text(x, y, room, ha="center", va="center", bbox=frame)
        axes.set_xlim(-7.0, 7.0)
        axes.set_ylim(-0.6, max(floors) + 0.6)
        axes.axis("off")
        plots.save_picture(figure, path)


def main() -> None:
    """Draw them all."""
    FOLDER.mkdir(exist_ok=True)
    depth_picture(FOLDER / "depth.png")
    voxmap_picture(FOLDER / "voxmap.svg")
    sampling_picture(FOLDER / "sampling.svg")
    poses_picture(FOLDER / "poses.png")
    rooms_picture(FOLDER / "rooms.svg")
    next_press_picture(FOLDER / "next_press.png")
    demo.run(FOLDER)
    for data in (*FOLDER.glob("*.nc"), *FOLDER.glob("report.*")):
        data.unlink()


if __name__ == "__main__":
    main()

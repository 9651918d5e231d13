"""Coverage of the stated uncertainty at places that were not measured.

    python benchmarks/coverage_at_places.py phantom_stiff phantom_stiff_frictionless

A folder holds a surface, recordings ``press_fit.csv`` and ``sweep_fit.csv``, and
recordings with the true force, ``press_test_truth.csv``, ``sweep_test_truth.csv`` and
``places_test_truth.csv``. The default model is fitted to the press alone, to the sweep
alone and to both. Frames with a true force above 0.5 N are counted by their distance
from the nearest fitted contact, and where they are deeper or lighter than everything
fitted within 20 mm. The interval of 95 % is the one stated for the true force, along
the rendered one.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ttus_opt as tt
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.fitting.uncertainty.uncertainty_check import NORMAL
from ttus_opt.fitting.weights.weight_choice import default_model

#: What is fitted
FITTED = (("press",), ("sweep",), ("press", "sweep"))

#: Recordings with true forces, and distances from the fitted contacts that are told
#: apart [m]
JUDGED = ("press", "sweep", "places")
DISTANCES = ((0.0, 0.02), (0.02, 0.05), (0.05, 0.1), (0.1, np.inf))

#: Least true force [N], distance of the fitted frames that say what depth was measured
#: [m], and fewest frames of a row
LEAST_FORCE, NEAR, FEWEST = 0.5, 0.02, 6

COLUMNS = (
    *("fitted", "judged", "frames", "covered", "mean error [N]"),
    *("mean stated [N]", "stated / error"),
)


@dataclass(frozen=True)
class Judged:
    """Errors and stated deviations along one recording.

    Attributes:
        error: Rendered minus true size of the force, shape (k,) [N].
        std: Stated standard deviation along the rendered force, shape (k,) [N].
        distance: From the nearest fitted contact, shape (k,) [m].
        deeper: Deeper than all fitted contacts within 20 mm, shape (k,).
        lighter: Less deep than all of them, shape (k,).
    """

    error: Array
    std: Array
    distance: Array
    deeper: Mask
    lighter: Mask

    def groups(self) -> Iterator[tuple[str, Mask]]:
        """Names and frames of what is told apart."""
        yield "all", np.ones(len(self.error), dtype=bool)
        for low, high in DISTANCES:
            name = f"{100 * low:g} to {100 * high:g} cm" if high < np.inf else "beyond"
            yield name, (self.distance >= low) & (self.distance < high)
        yield "deeper", self.deeper
        yield "lighter", self.lighter

    def cells(self, frames: Mask) -> list[str]:
        """Cells of a row of the table."""
        error, std = np.abs(self.error[frames]), self.std[frames]
        return [
            str(int(frames.sum())),
            f"{100 * np.mean(error <= NORMAL * std):.0f} %",
            f"{error.mean():.2f}",
            f"{std.mean():.2f}",
            f"{std.mean() / error.mean():.2f}",
        ]


def depths(surface: tt.Surface, shell: tt.PointShell, path: tt.Trajectory) -> Array:
    """Depth of the deepest point of the shell in every frame, shape (T,) [m]."""
    points = np.einsum("tij,mj->tmi", path.rotation, shell.points)
    x, y, z = np.moveaxis(points + path.position[:, None], -1, 0)
    below = surface.radius_at(np.arctan2(y, x), z) - np.hypot(x, y)
    return np.asarray(below.max(axis=1))


def judged(
    solution: tt.Solution, scene: tt.Scene, truths: Sequence[tt.Trajectory]
) -> Iterator[Judged]:
    """Errors and stated deviations of a fit along recordings with true forces."""
    stated, shell = tt.uncertainty(solution, scene), scene.shell
    surface, touching = scene.voxmap.surface, scene.rows.contact_points > 0
    fitted = scene.trajectory.select(touching)
    known = depths(surface, shell, fitted)
    for truth in truths:
        force = tt.evaluate(solution.field, shell, truth).rendered_force
        assert truth.force is not None
        size, true = (np.linalg.norm(f, axis=1) for f in (force, truth.force))
        along = force / np.maximum(size, np.finfo(float).tiny)[:, None]
        cov = stated.std(truth).covariance[:, :3, :3]
        std = np.sqrt(np.einsum("ti,tij,tj->t", along, cov, along))
        away = np.linalg.norm(truth.position[:, None] - fitted.position, axis=2)
        own = depths(surface, shell, truth)
        near = away < NEAR
        most = np.where(near, known, -np.inf).max(axis=1)
        least = np.where(near, known, np.inf).min(axis=1)
        counted, some = true > LEAST_FORCE, near.any(axis=1)
        yield Judged(
            *((size - true)[counted], std[counted], away.min(axis=1)[counted]),
            *((some & (own > most))[counted], (some & (own < least))[counted]),
        )


@dataclass(frozen=True)
class SceneOf:
    """Scenes of the recordings of a folder.

    Attributes:
        probe: Description of the probe.
        shape: Voxels in r, θ and z [–].
        r_inner: Radius of the innermost layer [m].
    """

    probe: str
    shape: tuple[int, int, int]
    r_inner: float = 0.03

    def __call__(self, folder: Path, names: Sequence[str]) -> tt.Scene:
        """The scene fitted to some of its recordings."""
        surface = tt.Surface.load(folder / "surface.nc")
        voxmap = tt.Voxmap.from_surface(surface, shape=self.shape, r_inner=self.r_inner)
        read = [tt.read_trajectory(folder / f"{name}_fit.csv") for name in names]
        shell = tt.PointShell.from_spec(self.probe)
        return tt.Scene.assemble(voxmap, shell, tt.Trajectory.concatenate(read))


def rows(folder: Path, scene_of: SceneOf) -> Iterator[str]:
    """Rows of a folder's table."""
    truths = [tt.read_trajectory(folder / f"{n}_test_truth.csv") for n in JUDGED]
    for names in FITTED:
        choice = default_model(scene_of(folder, names))
        solution = tt.fit(choice.scene, choice.formulation)
        for name, found in zip(
            JUDGED, judged(solution, choice.scene, truths), strict=True
        ):
            for group, frames in found.groups():
                if frames.sum() >= FEWEST:
                    cells = [" + ".join(names), f"{name}, {group}"]
                    yield f"| {' | '.join([*cells, *found.cells(frames)])} |"


def main() -> None:
    """Print a table for every folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--probe", default="ellipsoid:0.030,0.0125,0.018")
    parser.add_argument("--shape", default="24,72,30")
    options = parser.parse_args()
    warnings.simplefilter("ignore", tt.TtusWarning)
    n_r, n_theta, n_z = map(int, options.shape.split(","))
    scene_of = SceneOf(options.probe, (n_r, n_theta, n_z))
    for folder in options.folders:
        print(f"{folder.name}\n\n| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
        for row in rows(folder, scene_of):
            print(row, flush=True)
        print()


if __name__ == "__main__":
    main()

"""Coverage of the stated uncertainty at places that were not measured.

    python benchmarks/coverage_at_places.py phantom_stiff phantom_stiff_frictionless
    python benchmarks/coverage_at_places.py phantom phantom_stiff --noise 1

A folder holds a surface, recordings ``press_fit.csv`` and ``sweep_fit.csv``,
recordings of exact poses with the true force, ``press_test_truth.csv``,
``sweep_test_truth.csv`` and perhaps ``places_test_truth.csv`` (patients of the
experiment ``press_test_true.csv``, ``sweep_test_true.csv``), and the probe in
``probe.txt`` if it is not the bundled one, as `torsos.py` writes them. The default
model is fitted to the press alone, to the sweep alone and to both. Frames with a true
force above 0.5 N are counted by their distance from the nearest fitted contact, and
where they are deeper or lighter than everything fitted within 20 mm. The interval of
95 % is the one stated for the true force, along the rendered one. The last lines are of
all distances and depths of 20 frames or more. Errors at one place are alike, so that of
few places some bands are missed by the best statement: what chance gives is told from
errors that are drawn from the stated covariance itself, with its correlation between
frames.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import ttus_opt as tt
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.fitting.uncertainty.posterior import PosteriorDraws, kept_rows
from ttus_opt.fitting.uncertainty.uncertainty_check import NORMAL
from ttus_opt.fitting.uncertainty.wrench_uncertainty import (
    rendered,
    slopes_along,
    wrench_rows,
)
from ttus_opt.fitting.weights.weight_choice import default_model
from ttus_opt.phantom.recording import add_pose_noise
from ttus_opt.probe.tracker_noise import TrackerNoise

#: What is fitted
FITTED = (("press",), ("sweep",), ("press", "sweep"))

#: Recordings with true forces, and distances from the fitted contacts that are told
#: apart [m]
JUDGED = ("press", "sweep", "places")
DISTANCES = ((0.0, 0.02), (0.02, 0.05), (0.05, 0.1), (0.1, np.inf))

#: Least true force [N], distance of the fitted frames that say what depth was measured
#: [m], and fewest frames of a row and of what the last line counts
LEAST_FORCE, NEAR, FEWEST, ENOUGH = 0.5, 0.02, 6, 20

Rng = np.random.Generator

#: Draws of the errors [–], and depth below the skin down to which they are made [m]
DRAWS, DEPTH = 256, 0.05

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
        drawn: Errors drawn from the stated covariance, shape (k, draws) [N].
    """

    error: Array
    std: Array
    distance: Array
    deeper: Mask
    lighter: Mask
    drawn: Array

    def groups(self) -> Iterator[tuple[str, Mask]]:
        """Names and frames of what is told apart."""
        yield "all", np.ones(len(self.error), dtype=bool)
        for low, high in DISTANCES:
            name = f"{100 * low:g} to {100 * high:g} cm" if high < np.inf else "beyond"
            yield name, (self.distance >= low) & (self.distance < high)
        yield "deeper", self.deeper
        yield "lighter", self.lighter

    def figures(self, frames: Mask) -> Array:
        """Share of frames that are covered, mean error and mean stated [–, N, N].

        Returns:
            Shape (3, 1 + draws): of the errors, and of every draw of them.
        """
        error = np.abs(np.column_stack([self.error, self.drawn])[frames])
        std = self.std[frames, None]
        mean = np.broadcast_to(std.mean(), error.shape[1])
        return np.stack([np.mean(error <= NORMAL * std, 0), error.mean(0), mean])


def depths(surface: tt.Surface, shell: tt.PointShell, path: tt.Trajectory) -> Array:
    """Depth of the deepest point of the shell in every frame, shape (T,) [m]."""
    points = np.einsum("tij,mj->tmi", path.rotation, shell.points)
    x, y, z = np.moveaxis(points + path.position[:, None], -1, 0)
    below = surface.radius_at(np.arctan2(y, x), z) - np.hypot(x, y)
    return np.asarray(below.max(axis=1))


def drawn_errors(
    stated: tt.Uncertainty,
    scene: tt.Scene,
    path: tt.Trajectory,
    draws: PosteriorDraws,
    rng: Rng,
) -> Array:
    """Draws of the errors of rendered forces, alike where they are, (T, 3, DRAWS) [N].

    Those of the field and of its contact's size, and what no field has right at a
    place, new at every place.
    """
    rows = wrench_rows(stated.potential, scene.shell, path)
    wrench = rendered(stated.potential, rows)
    sized = slopes_along(stated.potential, scene.shell, path)[:, None] * wrench
    near, missing = kept_rows(rows, draws.voxels, 6)
    if missing.any():
        raise ValueError(f"frames reach deeper than draws are kept, {draws.depth} m")
    field = near @ draws.values.T + np.outer(sized.ravel(), draws.sizes)
    own = stated.noise.shared(wrench)[:, :3]
    place = tt.Scene.assemble(scene.voxmap, scene.shell, path).places
    unit = rng.standard_normal((place.max() + 1, own.shape[2], DRAWS))
    both = field.reshape(len(path), 6, DRAWS)[:, :3]
    return np.asarray(both + np.einsum("tij,tjk->tik", own, unit[place]))


def judged(
    solution: tt.Solution,
    scene: tt.Scene,
    truths: Sequence[tt.Trajectory],
    rng: Rng | None = None,
) -> Iterator[Judged]:
    """Errors and stated deviations of a fit along recordings with true forces.

    Args:
        solution: The fit.
        scene: What was fitted.
        truths: The recordings.
        rng: Draws errors from what is stated; None draws none.
    """
    stated, shell = tt.uncertainty(solution, scene), scene.shell
    if rng is not None:
        draws, order = stated.draws(DRAWS, DEPTH), rng.permutation(DRAWS)
        # every fit's are of the same random numbers: in another order independent
        draws = replace(draws, values=draws.values[order], sizes=draws.sizes[order])
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
        drawn = np.zeros((len(truth), 0))
        if rng is not None:
            errors = drawn_errors(stated, scene, truth, draws, rng)
            drawn = np.einsum("ti,tik->tk", along, errors)
        away = np.linalg.norm(truth.position[:, None] - fitted.position, axis=2)
        own = depths(surface, shell, truth)
        near = away < NEAR
        most = np.where(near, known, -np.inf).max(axis=1)
        least = np.where(near, known, np.inf).min(axis=1)
        counted, some = true > LEAST_FORCE, near.any(axis=1)
        yield Judged(
            *((size - true)[counted], std[counted], away.min(axis=1)[counted]),
            *((some & (own > most))[counted], (some & (own < least))[counted]),
            drawn[counted],
        )


@dataclass(frozen=True)
class SceneOf:
    """Scenes of the recordings of a folder.

    Attributes:
        probe: Description of the probe, but for folders with a ``probe.txt``.
        shape: Voxels in r, θ and z [–].
        noise: Of a tracker that reported the fitted poses [m]; 0 for exact ones.
        r_inner: Radius of the innermost layer [m].
    """

    probe: str
    shape: tuple[int, int, int]
    noise: float = 0.0
    r_inner: float = 0.03

    def __call__(self, folder: Path, names: Sequence[str]) -> tt.Scene:
        """The scene fitted to some of its recordings."""
        surface = tt.Surface.load(folder / "surface.nc")
        voxmap = tt.Voxmap.from_surface(surface, shape=self.shape, r_inner=self.r_inner)
        read = [tt.read_trajectory(folder / f"{name}_fit.csv") for name in names]
        if self.noise:
            rng = np.random.default_rng(len(names))
            noise = TrackerNoise(self.noise)
            read = [add_pose_noise(exact, rng, noise) for exact in read]
        own = folder / "probe.txt"
        spec = own.read_text().strip() if own.is_file() else self.probe
        shell = tt.PointShell.from_spec(spec)
        return tt.Scene.assemble(voxmap, shell, tt.Trajectory.concatenate(read))


def rows(
    folder: Path, scene_of: SceneOf, rng: Rng
) -> Iterator[tuple[list[str], int, Array]]:
    """Fitted, judged and group of a row, its frames and figures."""
    files = [next(folder.glob(f"{n}_test_tru*.csv"), None) for n in JUDGED]
    names = [n for n, file in zip(JUDGED, files, strict=True) if file]
    truths = [tt.read_trajectory(file) for file in files if file]
    for fitted in FITTED:
        choice = default_model(scene_of(folder, fitted))
        solution = tt.fit(choice.scene, choice.formulation)
        every = judged(solution, choice.scene, truths, rng)
        for name, found in zip(names, every, strict=True):
            for group, frames in found.groups():
                if (count := int(frames.sum())) >= FEWEST:
                    yield (
                        [" + ".join(fitted), name, group],
                        count,
                        found.figures(frames),
                    )


def main() -> None:
    """Print a table for every folder."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+")
    parser.add_argument("--probe", default="ellipsoid:0.030,0.0125,0.018")
    parser.add_argument("--shape", default="24,72,30")
    parser.add_argument("--noise", type=float, default=0.0, help="a tracker's [mm]")
    options = parser.parse_args()
    warnings.simplefilter("ignore", tt.TtusWarning)
    n_r, n_theta, n_z = map(int, options.shape.split(","))
    scene_of = SceneOf(options.probe, (n_r, n_theta, n_z), 1e-3 * options.noise)
    bands, rng = [], np.random.default_rng(0)
    for folder in options.folders:
        print(f"{folder.name}\n\n| {' | '.join(COLUMNS)} |\n{'|---' * len(COLUMNS)}|")
        for (fitted, name, group), count, figures in rows(folder, scene_of, rng):
            covered, error, std = figures[:, 0]
            cells = [fitted, f"{name}, {group}", str(count), f"{100 * covered:.0f} %"]
            cells += [f"{value:.2f}" for value in (error, std, std / error)]
            print(f"| {' | '.join(cells)} |", flush=True)
            if group != "all" and count >= ENOUGH:
                bands.append(figures)
        print()
    print(summary(np.array(bands)))


def summary(bands: Array) -> str:
    """What all bands have, and what chance gives: mean, and 90 % of the draws.

    Args:
        bands: `Judged.figures` of every band, shape (n, 3, 1 + draws).
    """
    covered, error, std = np.moveaxis(bands, 1, 0)
    ratio = std / error
    figures = {
        "% covered": 100.0 * covered.mean(axis=0),
        "bands below 90 %": np.sum(covered < 0.9, axis=0),
        "stated / error": np.exp(np.log(ratio).mean(axis=0)),
        "bands where it is above 1.5": np.sum(ratio > 1.5, axis=0),
    }
    lines = [f"{len(bands)} bands: found; were the errors drawn from what is stated"]
    for name, (found, *drawn) in figures.items():
        low, high = np.quantile(drawn, [0.05, 0.95])
        told = f"{found:.4g}; {np.mean(drawn):.4g} ({low:.4g} to {high:.4g})"
        lines.append(f"{name}: {told}")
    return "\n".join(lines)


if __name__ == "__main__":
    main()

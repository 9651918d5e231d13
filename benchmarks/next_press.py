"""Error at new places after five presses: suggested, at random, on a grid.

    python benchmarks/next_press.py phantom_stiff_frictionless phantom_stiff

A folder holds a surface, the recording ``press_fit.csv`` of one place, and 24 presses
at other places, ``places_test.csv`` with noise and ``places_test_truth.csv`` without.
The default model is fitted to the one place and five of the 24, and judged by the true
forces of the other 19: the mean error of the size of forces above 0.5 N.
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import ttus_opt as tt
from ttus_opt.contact.places import runs
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.fitting.uncertainty.field_uncertainty import Uncertainty
from ttus_opt.fitting.uncertainty.next_press import greedy, normal_forces
from ttus_opt.fitting.uncertainty.skin_uncertainty import (
    presses_at,
    skin_nodes,
    usual_depth,
)
from ttus_opt.fitting.weights.weight_choice import default_model

#: Presses chosen, draws at random, least true force [N], margin of the region around
#: the places [m], distance of its nodes [m]
CHOSEN, DRAWS, LEAST_FORCE, MARGIN, SPACING = 5, 20, 0.5, 0.01, 0.02

#: Five on a grid, as shares of the extent of the places around and along
GRID = ((0.2, 0.2), (0.8, 0.2), (0.5, 0.5), (0.2, 0.8), (0.8, 0.8))


@dataclass(frozen=True)
class Presses:
    """One phantom.

    Attributes:
        voxmap: Of the torso.
        shell: The probe.
        first: The recording of one place.
        measured: Presses at other places, with noise.
        truth: The same without.
        frames: Frames of each of these presses.
        deepest: The deepest frame of each, shape (k,).
    """

    voxmap: tt.Voxmap
    shell: tt.PointShell
    first: tt.Trajectory
    measured: tt.Trajectory
    truth: tt.Trajectory
    frames: tuple[IntArray, ...]
    deepest: IntArray

    @classmethod
    def read(cls, folder: Path, probe: str, shape: tuple[int, int, int]) -> Presses:
        """Read a folder; a press is a run of frames with a true force."""
        surface = tt.Surface.load(folder / "surface.nc")
        names = "press_fit.csv", "places_test.csv", "places_test_truth.csv"
        first, measured, truth = (tt.read_trajectory(folder / n) for n in names)
        assert truth.force is not None
        touching = np.linalg.norm(truth.force, axis=1) > 0.0
        run = runs(touching, truth.segment)
        frames = tuple(np.flatnonzero(run == r) for r in np.unique(run[touching]))
        size = np.linalg.norm(truth.force, axis=1)
        return cls(
            tt.Voxmap.from_surface(surface, shape=shape, r_inner=0.03),
            tt.PointShell.from_spec(probe),
            *(first, measured, truth, frames),
            np.array([own[size[own].argmax()] for own in frames]),
        )

    @property
    def places(self) -> Array:
        """Where the presses are: length around and along, shape (k, 2) [m]."""
        x, y, z = self.truth.position[self.deepest].T
        return np.stack([np.hypot(x, y).mean() * np.arctan2(y, x), z], axis=1)

    def fitted(self, chosen: Sequence[int]) -> tuple[tt.Solution, tt.Scene]:
        """Fit the first place and the chosen presses."""
        parts = [self.measured.select(self.frames[k]) for k in chosen]
        recorded = tt.Trajectory.concatenate([self.first, *parts])
        choice = default_model(tt.Scene.assemble(self.voxmap, self.shell, recorded))
        return tt.fit(choice.scene, choice.formulation), choice.scene

    def error(self, solution: tt.Solution, chosen: Sequence[int]) -> float:
        """Mean error over the presses that were not chosen [N]."""
        others = [own for k, own in enumerate(self.frames) if k not in chosen]
        truth = self.truth.select(np.concatenate(others))
        force = tt.evaluate(solution.field, self.shell, truth).rendered_force
        assert truth.force is not None
        size, true = (np.linalg.norm(f, axis=1) for f in (force, truth.force))
        return float(np.abs(size - true)[true > LEAST_FORCE].mean())

    def suggested(
        self, uncertainty: Uncertainty, count: int, taken: Sequence[int]
    ) -> list[int]:
        """The presses among those not taken that tell most about the region."""
        grid = skin_nodes(self.voxmap.surface, SPACING)
        theta, z = (a.ravel() for a in np.meshgrid(*grid, indexing="ij"))
        x, y, height = self.truth.position[self.deepest].T
        angle, margin = np.arctan2(y, x), MARGIN / float(np.hypot(x, y).mean())
        within = (theta >= angle.min() - margin) & (theta <= angle.max() + margin)
        within &= (z >= height.min() - MARGIN) & (z <= height.max() + MARGIN)
        nodes = presses_at(
            uncertainty.scene, theta[within], z[within], usual_depth(uncertainty.scene)
        )
        poses = replace(self.truth, force=None, torque=None)
        own = [poses.select(np.array([k])) for k in self.deepest]
        presses = tt.Trajectory.concatenate([nodes, *own])
        rows, sized, noise = normal_forces(uncertainty, presses)
        region = np.arange(len(presses)) < len(nodes)
        noise[region] = np.inf  # they are asked about, not pressed
        noise[len(nodes) + np.array(taken, dtype=np.int64)] = np.inf
        covariance = uncertainty.covariance(rows, len(presses), sized)[0]
        chosen, _, _ = greedy(covariance, noise, region, count)
        return [int(k) - len(nodes) for k in chosen]


def on_grid(places: Array) -> list[int]:
    """The presses nearest to `GRID`."""
    low, high = places.min(axis=0), places.max(axis=0)
    chosen: list[int] = []
    for share in GRID:
        away = np.linalg.norm(places - low - np.array(share) * (high - low), axis=1)
        away[chosen] = np.inf
        chosen.append(int(away.argmin()))
    return chosen


def report(presses: Presses) -> None:
    """Print the table of one phantom."""

    def error_of(chosen: Sequence[int]) -> float:
        return presses.error(presses.fitted(chosen)[0], chosen)

    print("| five presses | mean error [N] |\n|---|---|", flush=True)
    solution, scene = presses.fitted([])
    print(f"| none | {presses.error(solution, []):.3f} |", flush=True)
    at_once = presses.suggested(tt.uncertainty(solution, scene), CHOSEN, [])
    print(f"| suggested at once | {error_of(at_once):.3f} |", flush=True)
    stepwise: list[int] = []
    for _ in range(CHOSEN):
        stepwise += presses.suggested(tt.uncertainty(solution, scene), 1, stepwise)
        solution, scene = presses.fitted(stepwise)
    error = presses.error(solution, stepwise)
    print(f"| suggested one by one, fitted after each | {error:.3f} |", flush=True)
    print(f"| on a grid | {error_of(on_grid(presses.places)):.3f} |", flush=True)
    rng = np.random.default_rng(0)
    n = len(presses.frames)
    drawn = [rng.choice(n, CHOSEN, replace=False).tolist() for _ in range(DRAWS)]
    errors = np.array([error_of(chosen) for chosen in drawn])
    low, middle, high = np.quantile(errors, (0.25, 0.5, 0.75))
    print(
        f"| at random, median of {DRAWS} (quartiles) | {middle:.3f} ({low:.3f}–"
        f"{high:.3f}); {(errors < error).sum()} draws below one by one |\n"
    )


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
    for folder in options.folders:
        print(folder.name + "\n")
        report(Presses.read(folder, options.probe, (n_r, n_theta, n_z)))


if __name__ == "__main__":
    main()

"""Tuned weights beside an exhaustive grid, as docs/how-to/choosing-weights.md has it.

    python benchmarks/weights.py ../shared/data
    python benchmarks/weights.py ../shared/data --cases M

The grid has every pair of weights of force and torque and is judged by the errors on
recordings that were not fitted, which is more than anyone has who wants to fit. Cases S
and M are the bundled example; the others an independent phantom, with drag and without.
The last two columns are processor time, of a machine that has compiled the code.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import ttus_opt as tt
from ttus_opt import example
from ttus_opt.contact.scene import ScenePlan

#: Weights of the grid, per term [–]
GRID = np.geomspace(1e-2, 1e2, 13)

#: The phantom's true coefficient of friction, which the grid is given [–]
FRICTION = 0.25

S, M = (24, 72, 30), (48, 120, 60)


@dataclass(frozen=True)
class Case:
    """One row of the table."""

    name: str
    folder: Path
    shape: tuple[int, int, int]
    formulation: str

    def row(self) -> str:
        """Fit, judge, and write it down."""
        surface = tt.Surface.load(self.folder / "surface.nc")
        shell = tt.PointShell.from_spec(example.PROBE)
        fitted, unseen = (
            [tt.read_trajectory(self.folder / f"{n}_{use}.csv") for n in KINDS]
            for use in ("fit", "test")
        )
        scene = ScenePlan(self.shape).build(surface, shell, fitted)
        declared = tt.load_formulation(self.formulation, scene)
        if declared.search is not None:
            declared = declared.search.build(FRICTION)
        start = time.process_time()
        path = tt.solution_path(
            declared,
            scene,
            weights={"force": GRID, "torque": GRID},
            held_out=dict(zip(KINDS, unseen, strict=True)),
        )
        tuning = time.process_time()
        found = tt.tune(scene, self.formulation, compare=False)
        cost = tuning - start, time.process_time() - tuning
        grid = path.held_out_force_magnitude_error.mean("held_out").values
        solution = tt.fit(found.scene, found.formulation)
        error = np.mean(
            [
                tt.evaluate(solution.field, shell, one).errors.force_magnitude_error_N
                for one in unseen
            ]
        )
        best = float(np.nanmin(grid))
        at = np.unravel_index(int(np.nanargmin(grid)), grid.shape)
        print(self.name, "best of the grid at", *GRID[list(at)], file=sys.stderr)
        print(self.name, "tuned", dict(found.weights), file=sys.stderr)
        return (
            f"| {self.name} | {self.formulation} | {grid[0, 0]:.3f} | {best:.3f} | "
            f"{error:.3f} | {100.0 * (error / best - 1.0):.1f} % | "
            f"{cost[0]:.1f} s | {cost[1]:.1f} s |"
        )


KINDS = ("press", "sweep")

#: What `--cases` takes, in the order of the table
CASES = ("S", "no-drag", "drag", "M")


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("data", type=Path, help="folder with both phantoms")
    parser.add_argument(
        "--cases",
        nargs="+",
        choices=CASES,
        default=CASES,
        help="rows of the table; by default all",
    )
    asked = parser.parse_args()
    bundled = Path(example.path("surface.nc")).parent
    rows = (
        Case("S", bundled, S, "eq10"),
        Case("phantom without drag", asked.data / "phantom_frictionless", S, "eq10"),
        Case("phantom with drag", asked.data / "phantom", S, "coulomb_global"),
        Case("M", bundled, M, "eq10"),
    )
    cases = [row for row, name in zip(rows, CASES, strict=True) if name in asked.cases]
    titles = "case formulation weights_1e-2 best_of_the_grid tuned over_it grid tuning"
    print("|", *(f"{title.replace('_', ' ')} |" for title in titles.split()))
    print("|---" * len(titles.split()) + "|")
    for case in cases:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tt.TtusWarning)
            print(case.row(), flush=True)


if __name__ == "__main__":
    main()

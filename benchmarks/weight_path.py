"""What a path of weights costs, beside one fit and beside a fit for every weight.

    python benchmarks/weight_path.py
    python benchmarks/weight_path.py --formulation eq10_sign --weights 1e-4:1e2:9

CPU seconds of one run, so that another process on the machine matters little. Both ways
solve and verify every weight; fits alone begin anew each time, over a scene that is
assembled. At last the largest difference of fields of the two, relative.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace

import numpy as np

import ttus_opt as tt
from ttus_opt.benchmark import reference_cases
from ttus_opt.contact.scene import Scene


@contextmanager
def timed(what: str, told: dict[str, float]) -> Iterator[None]:
    """Note the CPU seconds of a block under a name."""
    start = time.process_time()
    yield
    told[what] = time.process_time() - start


def fresh(scene: Scene) -> Scene:
    """The same scene with nothing kept by earlier solves."""
    laplace = replace(scene.laplace)
    return replace(scene, laplace=laplace)


def main() -> None:
    """Run both ways and print a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--case", default="M", help="S, M or L")
    parser.add_argument("--formulation", default="eq10")
    parser.add_argument("--weights", default="1e-4:1e2:25", help="LOW:HIGH:COUNT")
    given = parser.parse_args()
    low, high, count = given.weights.split(":")
    weights = np.geomspace(float(low), float(high), int(count))
    case = reference_cases(given.case)[0]
    small = case.small().scene()  # compiles
    terms = ("force", "torque")
    tt.solution_path(given.formulation, small, weights={terms: weights[::6]})
    tt.fit(small, given.formulation)
    scene, told = case.scene(), dict[str, float]()
    with timed("path", told):
        path = tt.solution_path(
            given.formulation,
            fresh(scene),
            weights={terms: weights},
            extras=["potential"],
        )
    worst, alone = 0.0, []
    with timed("fits", told):
        for k, weight in enumerate(weights):
            start = time.process_time()
            solution = tt.fit(
                fresh(scene),
                given.formulation,
                force_weight=float(weight),
                torque_weight=float(weight),
            )
            alone.append(time.process_time() - start)
            values = solution.field.values
            off = np.abs(path["potential"].isel(force_weight=k).to_numpy() - values)
            worst = max(worst, float(off.max() / np.abs(values).max()))
    one = float(np.median(alone))
    print(f"{given.formulation} on {given.case}, {len(weights)} weights, CPU time")
    print(f"one fit   {one:8.2f} s  (median)")
    print(f"path      {told['path']:8.2f} s  {told['path'] / one:6.1f} fits")
    print(f"fits      {told['fits']:8.2f} s  {told['fits'] / one:6.1f} fits")
    print(
        f"points solved {int((path['status'] == 0).sum())}, KKT at most "
        f"{float(path['kkt_residual'].max()):.1e}, fields differ by {worst:.1e}"
    )


if __name__ == "__main__":
    main()

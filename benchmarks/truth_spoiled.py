"""The default and its rivals where skin, sensor or recordings are not what they should.

    python benchmarks/torsos.py torsos --count 6
    python benchmarks/truth_spoiled.py torsos
    python benchmarks/truth_spoiled.py torsos --only "a skin 3 mm too low" --json

The recordings of every torso are spoiled in one way at a time, fitted, and judged as in
`truth.py` by the true forces of exact poses. A row of the table has the error over that
of the recordings as they are, the error over that of the best rival of each score, and
how often the stated interval of 95 % holds less than 80 % of a recording's frames.
"""

from __future__ import annotations

import argparse
import json
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from coverage_at_places import depths, judged
from scipy.ndimage import gaussian_filter
from tqdm import tqdm
from truth import JUDGED, TORSO, Case

import ttus_opt as tt
from ttus_opt.core.arrays import Array, Mask
from ttus_opt.fitting.uncertainty.uncertainty_check import NORMAL
from ttus_opt.fitting.weights.weight_choice import default_model
from ttus_opt.phantom.recording import add_pose_noise
from ttus_opt.probe.tracker_noise import TrackerNoise

MODELS = (
    *("depth_map_coulomb", "c:stiffness_map", "r:kriged_power_law"),
    *("r:gaussian_process", "r:linear_spring"),
)

Recordings = list[tt.Trajectory]
Given = tuple[tt.Surface, Recordings]


@dataclass(frozen=True)
class Torso:
    """A torso as it is: skin, probe and recordings, and what draws errors of it."""

    skin: tt.Surface
    shell: tt.PointShell
    read: Recordings
    rng: np.random.Generator


Spoil = Callable[[Torso], Given]


def raised(metres: float) -> Spoil:
    """A skin that is everywhere too high by this much [m]."""
    return lambda one: (moved(one.skin, np.array(metres)), one.read)


def moved(skin: tt.Surface, by: Array) -> tt.Surface:
    """The skin with another radius, by (n_theta, n_z) or () [m]."""
    return tt.Surface.from_radius(skin.radius + by, skin.z, axis=skin.axis)


def bumps(one: Torso) -> Given:
    """A skin with bumps of 2 mm that are 2 to 3 cm wide."""
    noise = one.rng.standard_normal(one.skin.radius.shape)
    smooth = gaussian_filter(noise, 1.5, mode=("wrap", "nearest"))
    return moved(one.skin, 2e-3 * smooth / smooth.std()), one.read


def each(change: Callable[[tt.Trajectory], tt.Trajectory]) -> Spoil:
    """The same change of every recording."""
    return lambda one: (one.skin, [change(own) for own in one.read])


def off_zero(own: tt.Trajectory) -> tt.Trajectory:
    """0.3 N that the sensor shows in air, the same in the patient's axes."""
    assert own.force is not None
    return replace(own, force=own.force + 0.3 / np.sqrt(3.0))


def tracked(metres: float) -> Spoil:
    """Poses with a tracker's errors [m], alike for a second."""
    noise = TrackerNoise(metres)
    return lambda one: (
        *(one.skin, [add_pose_noise(own, one.rng, noise) for own in one.read]),
    )


def only(which: Callable[[Torso, tt.Trajectory], Mask]) -> Spoil:
    """Some frames, of the recordings that have any."""

    def kept(one: Torso) -> Given:
        masks = [which(one, own) for own in one.read]
        pairs = zip(one.read, masks, strict=True)
        return one.skin, [own.select(mask) for own, mask in pairs if mask.any()]

    return kept


def light(one: Torso, own: tt.Trajectory) -> Mask:
    """Whether the probe is at most 3 mm deep."""
    return np.asarray(depths(one.skin, one.shell, own) < 3e-3)


#: What is wrong, by name
SPOILS: dict[str, Spoil] = {
    "nothing": each(lambda own: own),
    "a skin 3 mm too low": raised(-3e-3),
    "a skin 3 mm too high": raised(3e-3),
    "a skin with bumps of 2 mm": bumps,
    "a sensor 0.3 N off zero": each(off_zero),
    "a tracker's noise of 0.3 mm": tracked(0.3e-3),
    "a tracker's noise of 0.7 mm": tracked(0.7e-3),
    "a tracker's noise of 1.5 mm": tracked(1.5e-3),
    "presses alone": lambda one: (one.skin, one.read[:1]),
    "a sweep alone": lambda one: (one.skin, one.read[1:]),
    "three presses alone": lambda one: (
        *(one.skin, [one.read[0].select(one.read[0].time < 6.0)]),
    ),
    "contacts of 3 mm alone": only(light),
    "the left side alone": only(lambda _, own: own.position[:, 0] > 0.0),
    "5 Hz": each(lambda own: own.select(slice(None, None, 4))),
    "forces alone": each(lambda own: replace(own, torque=None)),
}


@dataclass(frozen=True)
class Spoiled(Case):
    """A torso with something wrong."""

    wrong: str = "nothing"

    @cached_property
    def _spoiled(self) -> Given:
        read = [tt.read_trajectory(self.folder / name) for name in self.fitted]
        skin = tt.Surface.load(self.folder / "surface.nc")
        number = int("".join(filter(str.isdigit, self.name)) or 0)
        rng = np.random.default_rng(number)
        return SPOILS[self.wrong](Torso(skin, self.shell, read, rng))

    @property
    def surface(self) -> tt.Surface:
        """The skin as it is given."""
        return self._spoiled[0]

    @property
    def recordings(self) -> Recordings:
        """What is fitted."""
        return self._spoiled[1]

    def default(self) -> tuple[dict[str, Array], list[float]]:
        """Rendered forces of the default by recording, and shares that are covered."""
        scene = self.plan("").build(self.surface, self.shell, self.recordings)
        choice = default_model(scene)
        solution = tt.fit(choice.scene, choice.formulation)
        truths = list(self.unseen.values())
        found = judged(solution, choice.scene, truths)
        covered = [float(np.mean(abs(o.error) <= NORMAL * o.std)) for o in found]
        return self._rendered(solution), covered

    def row(self, models: Sequence[str]) -> dict[str, dict[str, float]]:
        """By judged recording: error by model [N], and "covered" [–]."""
        forces, covered = self.default()
        out: dict[str, dict[str, float]] = {}
        for (name, force), share in zip(forces.items(), covered, strict=True):
            out[name] = {"covered": share, "default": self.error(name, force)}
        for model in models:
            try:
                told, _ = self.forces(model)
            except tt.TtusError as error:
                tqdm.write(f"{self.name}, {self.wrong}: {model} refuses: {error}")
                continue
            for name, force in told.items():
                out[name][model] = self.error(name, force)
        return out

    def error(self, name: str, force: Array) -> float:
        """Mean error of the force's magnitude [N]."""
        return self.score(name, force)["error_N"]


HEAD = (
    *("wrong", "scores", "error / as it is", "error / best rival: mean, worst"),
    *("loses by 5 %", "covered below 80 %"),
)

Scores = Mapping[str, Mapping[str, Mapping[str, float]]]


def table(results: Mapping[str, Scores]) -> str:
    """Markdown: a line for everything that may be wrong."""
    lines: list[tuple[str, ...]] = [HEAD, ("---",) * len(HEAD)]
    for wrong, torsos in results.items():
        scores = {(t, n): own for t, rows in torsos.items() for n, own in rows.items()}
        error = np.array([own["default"] for own in scores.values()])
        known = results.get("nothing", torsos)
        before = np.array([known[t][n]["default"] for t, n in scores])
        rivals = [
            min(e for m, e in own.items() if m not in ("default", "covered"))
            for own in scores.values()
        ]
        ratio = error / rivals
        low = sum(own["covered"] < 0.8 for own in scores.values())
        mean = np.exp(np.log(ratio).mean())
        worse = np.exp(np.log(error / before).mean())
        line = wrong, str(len(error)), f"{worse:.2f}", f"{mean:.2f}, {ratio.max():.2f}"
        lines.append((*line, str(np.sum(ratio > 1.05)), str(low)))
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def main() -> None:
    """Compute and print the table."""
    usual = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=usual)
    parser.add_argument("folder", type=Path, help="that torsos.py has written")
    parser.add_argument("--only", nargs="+", choices=SPOILS, default=list(SPOILS))
    parser.add_argument("--shape", nargs=3, type=int, default=[24, 72, 30])
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    folders = sorted(path.parent for path in asked.folder.glob("*/probe.txt"))
    if not folders:
        parser.error(f"no */probe.txt in {asked.folder}: write it by torsos.py")
    warnings.simplefilter("ignore", tt.TtusWarning)
    results: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    for wrong in tqdm(asked.only, unit="fault"):
        for folder in folders:
            shape = tuple(asked.shape)
            known = folder.name, folder, TORSO, JUDGED, "torsos", shape
            rows = Spoiled(*known, wrong).row(MODELS)
            results.setdefault(wrong, {})[folder.name] = rows
    print(json.dumps(results, indent=1) if asked.json else table(results))


if __name__ == "__main__":
    main()

"""The default beside formulations, comparators and four short rivals, by unseen force.

    python benchmarks/truth.py --phantoms ../shared/data --tissue palpation
    python benchmarks/truth.py --cases patients --patients experiment-results
    python benchmarks/truth.py --cases torsos --torsos torsos --shape 24 72 30
    python benchmarks/truth.py --output truth.md --picture truth.png
    python benchmarks/truth.py --cases bundled --models eq10 comparators rivals
    python benchmarks/truth.py --phantoms ../shared/data --ablate --shape 24 72 30
    python benchmarks/truth.py --cases tissue --tissue palpation --patch 48 42 38

Cases: the independent phantoms (fitted to `*_fit`, judged on `*_test_truth` without
noise, and reversed), others as `torsos.py` draws them, real tissue as `palpation.py`
prepares it, a folder per recording, the patients of `ttus-opt experiment`, whose poses
have a tracker's noise, and the bundled example. A score is the mean of ||f| - |f̂||
[N] over frames above 0.5 N, of tissue over the rows in scored.txt; the share of them
that is off by more than 7 % and 0.36 N is kept too. Models: default, as
`tt.fit(scene, weights="auto")`; a formulation, or formulation@sampling; c:comparator;
r:rival; or a group of these. With ``--ablate`` they are the default with one part off
or changed (`truth_ablation.py`). A result is kept in a file per case, and computed
again when data, shape or code change.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from truth_ablation import MODELS
from truth_table import Row, against, errors, picture, table

import ttus_opt as tt
from ttus_opt import comparators, example
from ttus_opt.comparators.contact_geometry import ContactGeometry
from ttus_opt.contact.scene import ScenePlan
from ttus_opt.core import io
from ttus_opt.core.arrays import Array, IntArray, Mask
from ttus_opt.core.errors import InputError
from ttus_opt.problem.formulation import available

PHANTOMS = "phantom phantom_frictionless phantom_stiff phantom_stiff_frictionless"

#: A frame is judged above this force [N]; a difference is felt beyond both of these
LEAST, FELT = 0.5, (0.07, 0.36)

#: Frames of one press: no further apart than this [m] and [s]; frames within this time
#: [s] share their errors, where the probe slides on
JUMP, PAUSE, STRETCH = 0.004, 0.5, 2.0

#: Contacts a process is given at most; forces below are not fitted [N]
MOST, LEAST_FITTED = 400, 0.1

#: A millimetre of depth is as far as this way along the skin, for the neighbour [mm]
ALONG = 10.0

#: Where the search of these begins in each list [–]
STARTS = 0.2, 0.5, 0.8

#: Candidates of a process: exponent, noise over deviation (with less, the process takes
#: what the power law has wrong along a press for steep changes between feet that are
#: micrometres apart), lengths in place and depth [mm] and of the probe's direction [–]
EXPONENTS = np.round(np.arange(0.2, 3.01, 0.1), 1)
NOISES = np.geomspace(0.05, 10.0, 12)
LENGTHS = (
    np.geomspace(5.0, 160.0, 11),
    np.geomspace(1.0, 64.0, 13),
    np.geomspace(0.1, 6.4, 7),
)

# Rivals: from contacts and their forces, the force of other contacts ------------------


@dataclass(frozen=True)
class Contacts:
    """Depth (n,) and foot (n, 3) [mm], direction in the probe's axes (n, 3) [–]."""

    depth: Array = field(repr=False)
    place: Array = field(repr=False)
    direction: Array = field(repr=False)

    @classmethod
    def of(cls, geometry: ContactGeometry, poses: tt.Trajectory) -> Contacts:
        """Contact of every pose; its depth is 0 in the air."""
        surface, out = geometry.surface.surface, []
        for R, at in zip(poses.rotation, poses.position, strict=True):
            patch = geometry.touch(R, at).patch
            x, y, z = patch.centre
            theta = np.arctan2(y, x)
            radius = float(surface.radius_at(theta, z))
            foot = radius * np.cos(theta), radius * np.sin(theta), z
            out.append([patch.depth, *foot, *(R.T @ patch.direction)])
        table = np.array(out)
        return cls(1e3 * table[:, 0], 1e3 * table[:, 1:4], table[:, 4:])

    def __getitem__(self, rows: Any) -> Contacts:
        return Contacts(self.depth[rows], self.place[rows], self.direction[rows])


Law = Callable[[Contacts], Array]


def linear_spring(x: Contacts, force: Array) -> Law:
    """Force k h, by least squares."""
    stiffness = float(x.depth @ force / (x.depth @ x.depth))
    return lambda y: np.asarray(stiffness * y.depth)


def nearest_neighbour(x: Contacts, force: Array) -> Law:
    """The force of the contact that is nearest in place and depth."""

    def at(y: Contacts) -> Array:
        return np.asarray(np.c_[y.place / ALONG, y.depth])

    return lambda y: np.asarray(force[distance(at(y), at(x)).argmin(axis=1)])


def kriged_power_law(x: Contacts, force: Array) -> Law:
    """Force c hᵃ (1 + g(place)), g a Gaussian process."""
    return process(x, force, lambda y: [y.place])


def gaussian_process(x: Contacts, force: Array) -> Law:
    """Force c hᵃ (1 + g(place, depth, direction)), g a Gaussian process."""
    return process(x, force, lambda y: [y.place, y.depth[:, None], y.direction])


RIVALS: dict[str, Callable[[Contacts, Array], Law]] = {
    each.__name__: each
    for each in (linear_spring, nearest_neighbour, kriged_power_law, gaussian_process)
}


def distance(a: Array, b: Array) -> Array:
    """Distances of rows, shape (n, m)."""
    return np.asarray(np.sqrt(((a[:, None] - b[None]) ** 2).sum(axis=-1)))


def stretches(poses: tt.Trajectory, judged: Mask) -> IntArray:
    """Numbers of the stretches of judged frames whose errors are alike, (judged,).

    A stretch is one press, or `STRETCH` of it: frames without a jump of the probe.
    """
    at, time = poses.position[judged], poses.time[judged]
    new = np.linalg.norm(np.diff(at, axis=0, prepend=at[:1]), axis=1) > JUMP
    new |= np.diff(time, prepend=time[:1]) > PAUSE
    start = np.maximum.accumulate(np.where(new, np.arange(len(new)), 0))
    part = ((time - time[start]) / STRETCH).astype(int)
    return np.unique(np.stack([start, part]), axis=1, return_inverse=True)[1].ravel()


def sizes(poses: tt.Trajectory) -> Array:
    """|f| of every frame [N]."""
    assert poses.force is not None
    return np.asarray(np.linalg.norm(poses.force, axis=1))


def climbed(
    evidence: Callable[[list[float]], float], candidates: Sequence[Array], start: float
) -> tuple[float, list[float]]:
    """The largest evidence, one hyperparameter after the other, and where it is."""
    chosen, best = [float(c[int(start * len(c))]) for c in candidates], -np.inf
    while True:
        before = best
        for i, values in enumerate(candidates):
            trials = ([*chosen[:i], float(v), *chosen[i + 1 :]] for v in values)
            best, chosen = max([(best, chosen), *((evidence(t), t) for t in trials)])
        if best <= before:
            return best, chosen


def process(x: Contacts, force: Array, parts: Callable[[Contacts], list[Array]]) -> Law:
    """A power law times one plus a Matérn 3/2 process, all of it by evidence."""
    kept = slice(None, None, -(-len(force) // MOST))
    x, force = x[kept], force[kept]
    own = parts(x)
    apart = [distance(part, part) for part in own]

    def kernel(apart: list[Array], lengths: Sequence[float]) -> Array:
        far = [d / length for d, length in zip(apart, lengths, strict=True)]
        scaled = np.sqrt(3.0 * np.sum(np.square(far), axis=0))
        return np.asarray((1.0 + scaled) * np.exp(-scaled))

    def solved(exponent: float, noise: float, *lengths: float) -> tuple[Any, ...]:
        """Log evidence without its scale, then c and the weights of the forces."""
        power = x.depth**exponent
        mean = power @ force / (power @ power)
        cov = power[:, None] * power * kernel(apart, lengths)
        cov += noise**2 * float(np.mean(power**2)) * np.eye(len(power))
        factor = np.linalg.cholesky(cov)
        weights = np.linalg.solve(cov, force - mean * power)
        scale = float((force - mean * power) @ weights) / len(power)
        least = 1e-20 * float(np.mean(force**2) / np.mean(power**2))  # an exact law
        log_evidence = -0.5 * len(power) * np.log(max(scale, 0.0) + least)
        return log_evidence - np.log(np.diag(factor)).sum(), mean, power * weights

    candidates = [EXPONENTS, NOISES, *LENGTHS[: len(own)]]

    def evidence(trial: list[float]) -> float:
        return float(solved(*trial)[0])

    _, chosen = max(climbed(evidence, candidates, start) for start in STARTS)
    _, mean, weights = solved(*chosen)

    def law(y: Contacts) -> Array:
        far = [distance(a, b) for a, b in zip(parts(y), own, strict=True)]
        varied = mean + kernel(far, chosen[2:]) @ weights
        return np.asarray(y.depth ** chosen[0] * varied)

    return law


# Cases ------------------------------------------------------------------------------


@dataclass(frozen=True)
class Case:
    """Recordings to fit and to judge by, by name."""

    name: str
    folder: Path
    fitted: tuple[str, ...]
    judged: Mapping[str, str]
    kind: str
    shape: tuple[int, int, int]

    @cached_property
    def shell(self) -> tt.PointShell:
        """The probe."""
        own = self.folder / "probe.txt"
        spec = own.read_text().strip() if own.is_file() else example.PROBE
        if self.kind == "tissue":
            return tt.PointShell.from_spec(spec, n_points=400)
        return tt.PointShell.from_spec(spec)

    @cached_property
    def surface(self) -> tt.Surface:
        """The patient."""
        return tt.Surface.load(self.folder / "surface.nc")

    @cached_property
    def recordings(self) -> list[tt.Trajectory]:
        """What is fitted."""
        return [tt.read_trajectory(self.folder / name) for name in self.fitted]

    @cached_property
    def unseen(self) -> dict[str, tt.Trajectory]:
        """What is judged."""
        named = self.judged.items()
        return {name: tt.read_trajectory(self.folder / file) for name, file in named}

    def plan(self, sampling: str) -> ScenePlan:
        """The grid; of tissue a sector around the patch."""
        own: dict[str, Any] = {"sampling": sampling} if sampling else {}
        if self.kind == "tissue":
            low, high = map(float, (self.folder / "sector.txt").read_text().split())
            radius = self.surface.radius
            own |= {"sector": (low, high), "r_inner": float(radius.min()) - 0.012}
            own["r_outer"] = float(radius.max()) + 0.003
        return ScenePlan(self.shape, **own)

    def score(self, name: str, force: Array) -> dict[str, float]:
        """Error [N], share off by more than is felt [%], and number of frames."""
        size = sizes(self.unseen[name])
        error = np.abs(size - np.linalg.norm(force, axis=1))
        touch: Mask = size > LEAST
        if self.kind == "tissue":
            touch = np.zeros(len(size), dtype=bool)
            touch[np.loadtxt(self.folder / "scored.txt", int)] = True
        off = error > np.maximum(FELT[0] * size, FELT[1])
        stretch = stretches(self.unseen[name], touch)
        return {
            "error_N": float(error[touch].mean()),
            "off_percent": 100.0 * float(off[touch].mean()),
            "frames": int(touch.sum()),
            "frames_of_stretches": np.bincount(stretch).tolist(),
            "errors_of_stretches_N": np.bincount(stretch, error[touch]).tolist(),
        }

    def forces(self, model: str) -> tuple[dict[str, Array], str]:
        """Force on every unseen recording, and a note on how the model was fitted."""
        kind, _, name = model.rpartition(":")
        if kind == "c":
            made = comparators.create(name, surface=self.surface, shell=self.shell)
            found = made.fit(self.recordings)
            return {n: found.wrenches(u)[:, :3] for n, u in self.unseen.items()}, ""
        if kind == "r":
            return self._of_rival(RIVALS[name]), ""
        name, _, sampling = name.partition("@")
        scene = self.plan(sampling).build(self.surface, self.shell, self.recordings)
        if kind == "a":
            return self._rendered(tt.fit(*MODELS[name].choice(scene))), ""
        chosen, note = None if name == "default" else name, ""
        try:
            solution = tt.fit(scene, chosen, weights="auto")
        except InputError as error:  # it has no weights, or none that can be chosen
            if chosen is None:
                raise
            solution, note = tt.fit(scene, chosen), f"its own weights: {error}"
        return self._rendered(solution), note

    def _rendered(self, solution: tt.Solution) -> dict[str, Array]:
        field, unseen = solution.field, self.unseen.items()
        found = {n: tt.evaluate(field, self.shell, own) for n, own in unseen}
        return {n: one.rendered_force for n, one in found.items()}

    def _of_rival(self, rival: Callable[[Contacts, Array], Law]) -> dict[str, Array]:
        geometry = ContactGeometry(self.surface, self.shell)
        fitted = tt.Trajectory.concatenate(self.recordings)
        contacts = Contacts.of(geometry, fitted)
        size = sizes(fitted)
        used = (contacts.depth > 0.0) & (size > LEAST_FITTED)
        law, out = rival(contacts[used], size[used]), {}
        for name, unseen in self.unseen.items():
            touched = Contacts.of(geometry, unseen)
            force = np.where(touched.depth > 0.0, law(touched), 0.0)
            out[name] = np.maximum(force, 0.0)[:, None] * [0.0, 0.0, 1.0]
        return out

    def stamp(self) -> str:
        """Checksum of shape, data and code."""
        root = Path(__file__).resolve().parents[1]
        own = "ttus_opt/**/*.py", "formulations/*.py", "benchmarks/truth_ablation.py"
        code = (path for pattern in own for path in root.glob(pattern))
        data = (path for path in self.folder.iterdir() if path.is_file())
        sums = map(io.sha256, (Path(__file__), *sorted(code), *sorted(data)))
        return hashlib.sha256(" ".join([str(self.shape), *sums]).encode()).hexdigest()


Shape = tuple[int, int, int]

#: Recordings of a torso: fitted, and judged by their true force
TORSO = ("press_fit.csv", "sweep_fit.csv")
JUDGED = {name: f"{name}_test_truth.csv" for name in ("press", "sweep", "places")}


def of_torso(folder: Path, shape: Shape) -> Case:
    """The case of a folder that `torsos.py` has written."""
    return Case(folder.name, folder, TORSO, JUDGED, "torsos", shape)


def cases(
    phantoms: Path | None,
    torsos: Path | None,
    tissue: Path | None,
    patients: Path | None,
    shape: Shape | None,
    patch: Shape = (24, 42, 38),
) -> tuple[list[Case], list[str]]:
    """All cases whose data are there, and why others are not."""
    torso = shape or (48, 120, 60)
    bundled = Path(example.path("surface.nc")).parent
    found, skipped = [], []
    for name, sweep in (("example", "sweep"), ("example_drag", "sweep_drag")):
        fitted = "press_fit.csv", f"{sweep}_fit.csv"
        judged = {"press": "press_test.csv", "sweep": f"{sweep}_test.csv"}
        found.append(Case(name, bundled, fitted, judged, "bundled", torso))
    for name in PHANTOMS.split():
        folder = None if phantoms is None else phantoms / name
        if folder is None or not (folder / "surface.nc").is_file():
            reason = f"no {folder}/surface.nc" if folder else "give --phantoms"
            skipped.append(f"{name}: {reason}")
            continue
        for use, other, suffix in (("fit", "test", ""), ("test", "fit", "_reversed")):
            files = {n: f"{n}_{other}_truth.csv" for n in ("press", "sweep")}
            files |= {"places": "places_test_truth.csv"}
            judged = {n: file for n, file in files.items() if (folder / file).is_file()}
            fitted = f"press_{use}.csv", f"sweep_{use}.csv"
            found.append(Case(name + suffix, folder, fitted, judged, "phantoms", torso))
    drawn = sorted(p.parent for p in torsos.glob("*/probe.txt")) if torsos else []
    if not drawn:
        reason = f"no */probe.txt in {torsos}" if torsos else "give --torsos"
        skipped.append(f"torsos: {reason}")
    found += [of_torso(folder, torso) for folder in drawn]
    folders = sorted(p.parent for p in tissue.glob("*/scored.txt")) if tissue else []
    if not folders:
        reason = f"no */scored.txt in {tissue}" if tissue else "give --tissue"
        skipped.append(f"tissue: {reason}")
    files = {"tissue": "test.csv"}
    found += [
        Case(one.name, one, ("fit.csv",), files, "tissue", patch) for one in folders
    ]
    noisy = sorted(p.parent for p in patients.glob("*/surface.nc")) if patients else []
    if not noisy:
        reason = f"no */surface.nc in {patients}" if patients else "give --patients"
        skipped.append(f"patients: {reason}")
    judged = {n: f"{n}_test_true.csv" for n in ("press", "sweep")}
    found += [Case(p.name, p, TORSO, judged, "patients", torso) for p in noisy]
    return found, skipped


# Results ----------------------------------------------------------------------------


def run(case: Case, models: Iterable[str], results: Path) -> dict[str, Row]:
    """Results of a case by model; those of the same data, shape and code are kept."""
    file, stamp = results / f"{case.name}.json", case.stamp()
    kept = json.loads(file.read_text(encoding="utf-8")) if file.is_file() else {}
    for model in models:
        if kept.get(model, {}).get("stamp") == stamp:
            continue
        start = time.perf_counter()
        row: Row = {"stamp": stamp, "note": "", "scores": {}}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", tt.TtusWarning)
            try:
                forces, row["note"] = case.forces(model)
                row["scores"] = {n: case.score(n, f) for n, f in forces.items()}
            except tt.TtusError as error:
                row["note"] = f"refused: {error}"
        kept[model] = row | {"seconds": time.perf_counter() - start}
        io.write_bytes(file, json.dumps(kept, indent=1).encode())
        told = " / ".join(f"{s['error_N']:.3f}" for s in row["scores"].values())
        sys.stderr.write(f"{case.name} {model} {told or row['note']}\n")
    return {model: kept[model] for model in models}


def asked_of(arguments: Sequence[str] | None) -> argparse.Namespace:
    """The options, with the cases and models that they name."""
    usual = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=usual)
    members = {
        "formulations": [info.name for info in available()],
        "comparators": [f"c:{name}" for name in comparators.available()],
        "rivals": [f"r:{name}" for name in RIVALS],
        "ablation": [f"a:{name}" for name in MODELS],
    }
    add = parser.add_argument
    add("--phantoms", type=Path, help="folder of the four phantoms")
    add("--torsos", type=Path, help="folder that torsos.py has written")
    add("--tissue", type=Path, help="folder that palpation.py has written")
    add("--patients", type=Path, help="results of ttus-opt experiment")
    add("--results", type=Path, default=Path("truth"), help="kept in this folder")
    add("--cases", nargs="+", help="names, or bundled, phantoms, torsos, …")
    add("--models", nargs="+", default=list(members)[:3], help="beside the default")
    add("--ablate", action="store_true", help="as --models ablation")
    add("--shape", nargs=3, type=int, help="voxels of a torso, not of tissue")
    add("--patch", nargs=3, type=int, default=[24, 42, 38], help="voxels of tissue")
    add("--json", action="store_true", help="print JSON, not the table")
    add("--output", type=Path, help="write the table as Markdown here")
    add("--picture", type=Path, help="draw it here")
    asked = parser.parse_args(arguments)
    groups = ["ablation"] if asked.ablate else asked.models
    models = [m for name in groups for m in members.get(name, [name])]
    known = ["default", *(name for group in members.values() for name in group)]
    for name in models:
        plain, sampled, _ = name.partition("@")
        if plain not in (members["formulations"] if sampled else known):
            parser.error(f"no model {name}: take {', '.join([*members, *known])}")
    asked.models = list(dict.fromkeys(["default", *models]))
    shape = tuple(asked.shape) if asked.shape else None
    data = asked.phantoms, asked.torsos, asked.tissue, asked.patients
    asked.found, asked.skipped = cases(*data, shape, tuple(asked.patch))
    named = dict.fromkeys(w for case in asked.found for w in (case.name, case.kind))
    wanted = set(asked.cases or named)
    if wanted - set(named):
        lost, there = ", ".join(sorted(wanted - set(named))), ", ".join(named)
        why = "; ".join(asked.skipped)
        parser.error(f"no case {lost}: take {there}; skipped are {why or 'none'}")
    asked.found = [case for case in asked.found if {case.name, case.kind} & wanted]
    return asked


def main(arguments: Sequence[str] | None = None) -> None:
    """Compute what is not kept yet, and report."""
    asked = asked_of(arguments)
    for reason in [] if asked.cases else asked.skipped:
        sys.stderr.write(f"skipped {reason}\n")
    asked.results.mkdir(parents=True, exist_ok=True)
    results = {
        case.name: run(case, asked.models, asked.results) for case in asked.found
    }
    found, text = errors(results), table(results)
    if asked.output:
        io.write_bytes(asked.output, f"{text}\n".encode())
    if asked.picture:
        tt.plots.save_picture(picture(found), asked.picture)
    facts = {"skipped": asked.skipped, "results": results, "against": against(found)}
    print(json.dumps(facts, indent=1) if asked.json else text)


if __name__ == "__main__":
    main()

"""Make finite-element torsos that nothing in the package was chosen by.

    python benchmarks/torsos.py torsos --count 12
    python benchmarks/torsos.py torsos --first 100 --count 6
    python benchmarks/truth.py --torsos torsos --cases torsos --shape 24 72 30
    python benchmarks/coverage_at_places.py torsos/*

A number makes a torso: its shape, softness, ribs, probe, drag and how far to either
side of the front it is pressed are drawn with that seed. Each gets a folder with the
skin, the probe, ten presses and a sweep with the sensor's noise to fit to, and others
with the true force to judge by: ten presses, a sweep, and 60 presses at new places,
of which most are far from what was fitted. It takes half a minute each.
"""

from __future__ import annotations

import argparse
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from tqdm import tqdm

from ttus_opt.core.arrays import Array
from ttus_opt.phantom.elasticity import skin_compliance
from ttus_opt.phantom.examination import RATE, SECONDS, Handling
from ttus_opt.phantom.press import CoulombDrag
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.recording import add_noise, record
from ttus_opt.phantom.torso import Torso, TorsoMesh, torso_body

#: Semi-axes of the probes [m]
PROBES = (0.030, 0.0125, 0.018), (0.035, 0.015, 0.015), (0.020, 0.020, 0.020)

#: Young's modulus of soft tissue [Pa], and that of ribs and lump over it [–]
SOFT, HARDER = (6e3, 40e3), (1.0, 4.0, 10.0)

#: Friction coefficients [–], and how far to either side of the front is pressed [rad]
FRICTION, REACH = (0.0, 0.0, 0.25, 0.4), np.radians((15.0, 48.0))

#: Where the lump's centre may be: x, y and z [m]
LUMP = (-0.04, 0.04), (0.075, 0.090), (0.10, 0.20)

#: The mesh: the patch reaches as far as the widest probe, at the largest reach
MESH = TorsoMesh(1.7, (np.radians(20.0), np.radians(160.0)), (0.055, 0.245))

#: Depth of the deepest press and of a sweep, least and largest [m]; where presses are
#: along the body [m]; presses of a recording, of new places
DEEPEST, SWEPT, ALONG = 0.012, (0.004, 0.010), (0.09, 0.21)
PRESSES, PLACES = 10, 60


def presses(rng: np.random.Generator, count: int, side: float, each: float) -> Handling:
    """Presses at random places within ``side`` [m] of the front, ``each`` [s] long."""
    frames = round(each * RATE)
    rise = np.sin(np.pi * np.arange(frames) / frames) ** 2
    lift, deepest = -0.002, DEEPEST * rng.uniform(0.6, 1.0, count)
    depth = lift + np.outer(deepest - lift, rise)
    ranges = (-side, side), ALONG, (-0.2, 0.2), (-0.2, 0.2), (-0.5, 0.5)
    held = [np.repeat(rng.uniform(*limits, count), frames) for limits in ranges]
    time = np.arange(count * frames) / RATE
    return Handling(time, held[0], held[1], depth.ravel(), *held[2:])


def sweep(rng: np.random.Generator, side: float) -> Handling:
    """One line that winds over all that is pressed."""
    time = np.arange(round(SECONDS * RATE)) / RATE

    def wave(middle: float, half: float, frequency: float) -> Array:
        phase = 2.0 * np.pi * (frequency * time + rng.uniform())
        return np.asarray(middle + half * np.sin(phase))

    along, depth = ((sum(x) / 2, (x[1] - x[0]) / 2) for x in (ALONG, SWEPT))
    across = wave(0.0, side, 1.5 / SECONDS)
    tilts = wave(0.0, 0.25, 0.1), wave(0.0, 0.25, 0.13), wave(0.0, 0.5, 0.07)
    return Handling(
        time, across, wave(*along, 1.0 / SECONDS), wave(*depth, 0.17), *tilts
    )


@dataclass(frozen=True)
class Drawn:
    """A torso, the probe that presses it, its friction and its reach [m]."""

    torso: Torso
    probe: EllipsoidProbe
    friction: float
    side: float

    @classmethod
    def of(cls, rng: np.random.Generator) -> Drawn:
        """Draw one."""
        soft = float(np.exp(rng.uniform(*np.log(SOFT))))
        hard, rib = soft * float(rng.choice(HARDER)), float(rng.uniform(0.010, 0.020))
        torso = Torso(
            half_axes=(float(rng.uniform(0.14, 0.18)), float(rng.uniform(0.095, 0.12))),
            exponent=float(rng.uniform(2.0, 2.5)),
            swell=float(rng.uniform(0.02, 0.1)),
            soft=soft,
            rib=hard,
            lump=hard,
            rib_pitch=float(rng.uniform(0.03, 0.045)),
            rib_depth=(rib, rib + 0.011),
            rib_from=float(rng.uniform(0.08, 0.16)),
            lump_centre=(
                float(rng.uniform(*LUMP[0])),
                float(rng.uniform(*LUMP[1])),
                float(rng.uniform(*LUMP[2])),
            ),
        )
        front = float(torso.radius(np.array(np.pi / 2), np.array(torso.length / 2)))
        return cls(
            torso,
            EllipsoidProbe(PROBES[rng.integers(len(PROBES))]),
            float(rng.choice(FRICTION)),
            front * float(rng.uniform(*REACH)),
        )


def write(folder: Path, number: int) -> Drawn:
    """Make a torso, press it and write skin, probe and recordings to a new folder."""
    rng = np.random.default_rng(number)
    drawn = Drawn.of(rng)
    torso, probe, side = drawn.torso, drawn.probe, drawn.side
    handlings = {
        "press_fit": presses(rng, PRESSES, side, 2.0),
        "sweep_fit": sweep(rng, side),
        "press_test": presses(rng, PRESSES, side, 2.0),
        "sweep_test": sweep(rng, side),
        "places_test": presses(rng, PLACES, side, 1.0),
    }
    patch = skin_compliance(torso_body(torso, MESH))
    drag = CoulombDrag(drawn.friction) if drawn.friction else None
    part = folder.with_suffix(".part")  # a folder that is there is whole
    shutil.rmtree(part, ignore_errors=True)
    part.mkdir(parents=True)
    torso.surface(120, 31).save(part / "surface.nc")
    for name, handling in handlings.items():
        true = record(patch, probe, handling.poses(torso, probe), drag=drag)
        true.save(part / f"{name}_truth.csv")
        add_noise(true, rng).save(part / f"{name}.csv")
    spec = ",".join(f"{axis:g}" for axis in probe.semi_axes)
    (part / "probe.txt").write_text(f"ellipsoid:{spec}\n")  # by which it is found
    part.rename(folder)
    return drawn


def main() -> None:
    """Write the torsos that are not there yet, and say what they are."""
    usual = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=usual)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--first", type=int, default=0, help="number of the first")
    parser.add_argument("--count", type=int, default=12)
    asked = parser.parse_args()
    if asked.first < 0 or asked.count < 1:
        parser.error("numbers begin at 0, and there is at least one torso")
    numbers = range(asked.first, asked.first + asked.count)
    for number in tqdm(numbers, desc="torsos", unit="torso"):
        folder = asked.folder / f"torso{number:03d}"
        if folder.exists():
            continue
        drawn = write(folder, number)
        tqdm.write(
            f"{folder.name}: {1e-3 * drawn.torso.soft:.0f} kPa, ribs "
            f"{drawn.torso.rib / drawn.torso.soft:g} times, friction "
            f"{drawn.friction:g}, {1e3 * drawn.side:.0f} mm to either side"
        )


if __name__ == "__main__":
    main()

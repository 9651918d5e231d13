"""The default on flat, round and sharp probes over half-space, layer, ribbed layer.

    python benchmarks/contact_bodies.py --models default,depth_map,stiffness_map

Forces of presses follow from contact mechanics, not from a field: a sphere on a
half-space (Hertz 1881), a flat square punch on it (Johnson, Contact Mechanics, 1985,
§3.8), and a thin layer on a rigid base, whose pressure is its modulus over its
thickness times the depth (ibid., §5.8), the thickness constant or a wave as of ribs,
integrated over the contact. The body is a cylinder, as the grid is; the flat probe
follows its curve, so that relative to the body it is flat.
Half of the places are fitted, with noise, half are predicted: mean error of the
force's magnitude over its mean, in percent, and over draws of places and noise the
mean and its standard error. No option is set for any of the models.
"""

from __future__ import annotations

import argparse
import math
import sys
import time
import warnings
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt import comparators
from ttus_opt.comparators.fields import FieldModel
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import TtusError
from ttus_opt.fitting.batch import fit
from ttus_opt.fitting.weights.weight_choice import default_model
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.solution import Solution
from ttus_opt.scan.surface import Surface

#: Radius and height of the body; it is flat on the scale of a contact [m]
BODY, HEIGHT = 0.15, 0.2

#: Places, depths of each as a part of the deepest [–]
PLACES, DEPTHS = 60, np.linspace(0.15, 1.0, 6)

#: Half width of what is pressed: angle [rad], height [m]
WIDTH = 0.35, 0.06

#: Bodies that are pressed
BODIES = ("half-space", "layer", "ribbed")

#: Reduced modulus of the half-space [Pa]; modulus of the layer and its thickness [m]
HALF_SPACE, LAYER, THICKNESS = 30e3, 60e3, 0.03

#: Wave of the ribs: length [m], share of the thickness [–]
RIBS = 0.035, 0.5

#: Noise of a component: of force [N], relative [–]; of torque [N·m]
NOISE = 0.02, 0.03, 2e-3

SHAPE, R_INNER = (20, 90, 30), 0.12


class Default(FieldModel):
    """What ``ttus-opt fit`` takes without an option."""

    name = "default"

    def _solved(self, scene: Scene) -> Solution:
        choice = default_model(scene)
        sys.stderr.write(f"{choice.formulation.name}, {choice.scene.sampling}\n")
        return fit(choice.scene, choice.formulation)


def probes() -> dict[str, tuple[PointShell, float, float]]:
    """Shell, half its thickness along the press [m], deepest press [m], by name."""
    box = PointShell.box((0.02, 0.02, 0.02), 1500)
    return {
        "round": (PointShell.sphere(0.02, 1500), 0.02, 0.006),
        "flat": (bent(box, 0.01), 0.01, 0.004),
        "sharp": (PointShell.sphere(0.00315, 800), 0.00315, 0.002),
    }


def bent(box: PointShell, half: float) -> PointShell:
    """A box that is pressed along -x, its face bent to follow the body's.

    Args:
        box: Around the origin.
        half: Half its thickness [m].
    """
    x, y, z = box.points.T
    angle, radius = y / BODY, BODY + half + x
    points = [radius * np.cos(angle) - BODY - half, radius * np.sin(angle), z]
    normals = Rotation.from_euler("z", angle[:, None]).apply(box.normals)
    return replace(box, points=np.stack(points, axis=1), normals=normals)


def stiffness(body: str, z: Array) -> Array:
    """Pressure over depth of a layer at heights [Pa/m]."""
    length, share = RIBS
    wave = share * np.sin(2.0 * np.pi * z / length) if body == "ribbed" else 0.0 * z
    return LAYER / (THICKNESS * (1.0 + wave))


def force(body: str, probe: str, depth: float, z: float) -> float:
    """The exact force of a press [N]."""
    size = {"round": 0.02, "flat": 0.02, "sharp": 0.00315}[probe]
    if body == "half-space":
        if probe == "flat":  # a square punch is as stiff as a round one, to 1.2 %
            return 2.0 * HALF_SPACE * 1.012 * math.sqrt(size**2 / math.pi) * depth
        return 4.0 / 3.0 * HALF_SPACE * math.sqrt(size * depth) * depth
    # a strip of the contact at every height: its width times its mean depth
    half = size / 2.0 if probe == "flat" else math.sqrt(2.0 * size * depth)
    u = half * np.linspace(-1.0, 1.0, 401)
    if probe == "flat":
        strip = np.full_like(u, size * depth)
    else:
        left = np.maximum(depth - u**2 / (2.0 * size), 0.0)
        strip = 4.0 / 3.0 * np.sqrt(2.0 * size) * left**1.5
    return float(np.trapezoid(stiffness(body, z + u) * strip, u))


def recording(body: str, probe: str, rng: np.random.Generator) -> Trajectory:
    """Presses at random places, the probe's z axis along the radius."""
    _, thick, deepest = probes()[probe]
    angle = rng.uniform(-WIDTH[0], WIDTH[0], PLACES)
    height = HEIGHT / 2 + rng.uniform(-WIDTH[1], WIDTH[1], PLACES)
    position, rotation, forces = [], [], []
    for a, z in zip(angle, height, strict=True):
        outward = np.array([math.cos(a), math.sin(a), 0.0])
        turn = Rotation.from_euler("z", a).as_matrix()
        for depth in (-0.005, *(DEPTHS * deepest), -0.005):
            position.append((BODY + thick - depth) * outward + [0.0, 0.0, z])
            rotation.append(turn)
            size = force(body, probe, depth, z) if depth > 0.0 else 0.0
            forces.append(size * outward)
    time_ = 0.2 * np.arange(len(position), dtype=float)
    return Trajectory(time_, np.array(position), np.array(rotation), np.array(forces))


def noisy(exact: Trajectory, rng: np.random.Generator) -> Trajectory:
    """Measured forces."""
    assert exact.force is not None
    size = np.linalg.norm(exact.force, axis=1, keepdims=True)
    std = NOISE[0] + NOISE[1] * size
    measured = exact.force + std * rng.standard_normal(exact.force.shape)
    torque = NOISE[2] * rng.standard_normal(measured.shape)  # by symmetry noise alone
    return Trajectory(exact.time, exact.position, exact.rotation, measured, torque)


def error(model: str, body: str, probe: str, sampling: str, seed: int) -> float:
    """Held-out mean error over the mean force [–]."""
    rng = np.random.default_rng(seed)
    whole = recording(body, probe, rng)
    half = len(whole) // 2
    told = noisy(whole.select(np.arange(half)), rng)
    unseen = whole.select(np.arange(half, 2 * half))
    surface = Surface.from_radius(np.full((90, 31), BODY), np.linspace(0, HEIGHT, 31))
    kind = Default if model == "default" else comparators.kind(model)
    shell = probes()[probe][0]
    if issubclass(kind, FieldModel):
        ours = kind(surface=surface, shell=shell, shape=SHAPE, r_inner=R_INNER)
        ours.plan = replace(ours.plan, sampling=sampling)
        fitted: comparators.Comparator = ours.fit(told)
    else:
        fitted = kind(surface=surface, shell=shell).fit(told)
    assert unseen.force is not None
    size = np.linalg.norm(unseen.force, axis=1)
    touching = size > 0.0
    found = np.linalg.norm(fitted.wrenches(unseen)[:, :3], axis=1)
    return float(np.abs(found - size)[touching].mean() / size[touching].mean())


def percent(model: str, body: str, probe: str, sampling: str, seeds: list[int]) -> str:
    """Mean over seeds and its standard error [%]."""
    begin, errors = time.process_time(), []
    for seed in seeds:
        try:
            errors.append(100.0 * error(model, body, probe, sampling, seed))
        except TtusError as refusal:
            sys.stderr.write(f"{model}: {refusal}\n")
            errors.append(math.nan)
    sys.stderr.write(f"{model} {time.process_time() - begin:.1f} s\n")
    if len(seeds) == 1:
        return f"{errors[0]:.1f}"
    spread = np.std(errors, ddof=1) / math.sqrt(len(seeds))
    return f"{np.mean(errors):.1f} ± {spread:.1f}"


def numbers(text: str) -> list[int]:
    """Whole numbers between commas."""
    return [int(word) for word in text.split(",")]


def words_of(*known: str) -> Callable[[str], list[str]]:
    """Reads some of the known words between commas."""

    def read(text: str) -> list[str]:
        words = text.split(",")
        unknown = [word for word in words if word not in known]
        if unknown:
            raise argparse.ArgumentTypeError(
                f"unknown {', '.join(unknown)}: choose from {', '.join(known)}"
            )
        return words

    return read


def main() -> None:
    """Print a row per probe and body."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", default="default,depth_map,stiffness_map")
    for name, known in (("--probes", tuple(probes())), ("--bodies", BODIES)):
        parser.add_argument(name, type=words_of(*known), default=list(known))
    parser.add_argument("--sampling", default="trilinear", help="of the fields")
    parser.add_argument("--seeds", type=numbers, default=[0], help="such as 0,1,2,3,4")
    options = parser.parse_args()
    models, seeds = options.models.split(","), options.seeds
    warnings.simplefilter("ignore")
    sys.stdout.write(f"| probe | body | {' | '.join(models)} |\n")
    for probe in options.probes:
        for body in options.bodies:
            cells = " | ".join(
                percent(model, body, probe, options.sampling, seeds) for model in models
            )
            sys.stdout.write(f"| {probe} | {body} | {cells} |\n")
            sys.stdout.flush()


if __name__ == "__main__":
    main()

"""Three phantom patients of different build, stiffness, ribs and lumps.

Two have superelliptic cross-sections. The third has the skin of a given scan, otherwise
the mean of the others' shapes. Tissue is linear elastic; the moduli are those of
relaxed to tense muscle and fat (15 to 32 kPa). Ribs are ten times as stiff, so that
they feel rigid to a probe.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, field, replace

import numpy as np

from ttus_opt.phantom.examination import Handling, push_handling, sweep_handling
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.scanned import ScannedTorso
from ttus_opt.phantom.torso import Torso, TorsoMesh
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.surface import Surface

#: The probe of every recording, for the phantom and for the package
PROBE, PROBE_SPEC = (
    EllipsoidProbe((0.030, 0.0125, 0.018)),
    "ellipsoid:0.030,0.0125,0.018",
)

#: Recordings of every patient, two to fit and two of new motion, with offsets of seeds
RECORDINGS = {"press_fit": 0, "sweep_fit": 10, "press_test": 20, "sweep_test": 30}

#: Name of the patient with the skin of a scan
SCANNED = "scanned"

#: Half width of the skin that may be pressed, as arc length [m]
REACH = 0.052


@dataclass(frozen=True)
class Patient:
    """A phantom and how it is examined.

    Attributes:
        name: Name of files and table rows.
        build: A description.
        torso: Shape and tissue.
        deepest: Depth of the deepest press [m].
        sweep_depth: Smallest and largest depth of a sweep [m].
        drag: Coulomb coefficient of skin and gel [–].
        damping: Hunt–Crossley damping of the tissue, see `phantom.press` [s/m].
        seed: Seed of paths and noise; a recording adds its offset of `RECORDINGS`.
    """

    name: str
    build: str
    torso: Torso = field(repr=False)
    deepest: float
    sweep_depth: tuple[float, float]
    drag: float
    damping: float
    seed: int

    def mesh(self, resolution: float) -> TorsoMesh:
        """The mesh of its body; resolution 1 is fine, 2 coarse."""
        torso = self.torso
        front = float(torso.radius(np.array(np.pi / 2), np.array(torso.length / 2)))
        half = REACH / front
        return TorsoMesh(resolution, (np.pi / 2 - half, np.pi / 2 + half))

    def handling(self, recording: str) -> Handling:
        """The examiner's motion in one of `RECORDINGS`."""
        rng = np.random.default_rng(self.seed + RECORDINGS[recording])
        if recording.startswith("press"):
            return push_handling(rng, deepest=self.deepest)
        across = 0.006 if recording.endswith("test") else -0.006
        return sweep_handling(rng, across=across, depth=self.sweep_depth)

    def poses(self, recording: str) -> Trajectory:
        """The probe's true path, without a wrench."""
        return self.handling(recording).poses(self.torso, PROBE)

    def surface(self) -> Surface:
        """The true skin, 2° by 5 mm; bilinear interpolation is accurate to 0.1 mm."""
        theta = np.linspace(0.0, 2.0 * np.pi, 180, endpoint=False)
        z = np.linspace(0.0, self.torso.length, 61)
        return Surface.from_radius(self.torso.radius(theta[:, None], z), z)

    def digest(self, resolution: float) -> str:
        """Checksum of the input of its recordings."""
        skin = self.surface().radius.round(7).tobytes()
        text = repr((self, self.torso, self.mesh(resolution), PROBE, RECORDINGS))
        return hashlib.sha256(text.encode() + skin).hexdigest()[:16]


def names(*, scanned: bool) -> tuple[str, ...]:
    """Names of the three patients, without reading the scan."""
    *made_up, third = (each.name for each in patients())
    return (*made_up, SCANNED if scanned else third)


def patients(scan: Surface | None = None) -> tuple[Patient, ...]:
    """The three patients.

    Args:
        scan: The surface of a real torso, for the third of them.
    """
    return (_lean(), _stout(), _average() if scan is None else _scanned(scan))


def _lean() -> Patient:
    torso = Torso(
        half_axes=(0.145, 0.098),
        exponent=2.2,
        swell=0.03,
        core_radius=0.030,
        back_height=-0.090,
        soft=32e3,
        rib=400e3,
        lump=150e3,
        rib_depth=(0.010, 0.020),
    )
    torso = _with_lump(torso, 82.0, 0.112, 0.018, 0.009)
    build = "lean, 32 kPa, ribs from 10 mm, a lump of 18 mm"
    return Patient("lean", build, torso, 0.012, (0.004, 0.010), 0.20, 1.5, 1000)


def _stout() -> Patient:
    torso = Torso(
        half_axes=(0.190, 0.140),
        exponent=2.5,
        swell=0.05,
        back_height=-0.128,
        soft=15e3,
        rib=150e3,
        lump=80e3,
        rib_depth=(0.022, 0.032),
    )
    torso = _with_lump(torso, 96.0, 0.120, 0.026, 0.016)
    build = "stout, 15 kPa, ribs from 22 mm, a lump of 32 mm"
    return Patient("stout", build, torso, 0.016, (0.007, 0.013), 0.30, 3.0, 2000)


def _average() -> Patient:
    torso = Torso(half_axes=(0.168, 0.119), exponent=2.35)
    build = "average, 20 kPa, ribs from 12 mm, a lump of 24 mm"
    return _medium("average", build, torso)


def _scanned(scan: Surface) -> Patient:
    torso = ScannedTorso.of(scan, Torso(back_height=-0.090))
    build = "skin of a real torso, 20 kPa, ribs from 12 mm, a lump of 24 mm"
    return _medium(SCANNED, build, torso)


def _medium(name: str, build: str, torso: Torso) -> Patient:
    torso = _with_lump(torso, 90.0, 0.105, 0.020, 0.012)
    return Patient(name, build, torso, 0.014, (0.005, 0.012), 0.25, 2.0, 3000)


def _with_lump(
    torso: Torso, degrees: float, z: float, depth: float, radius: float
) -> Torso:
    """The torso with its lump at a depth below its skin [m]."""
    theta = np.radians(degrees)
    r = float(torso.radius(np.array(theta), np.array(z))) - depth
    centre = (float(r * np.cos(theta)), float(r * np.sin(theta)), z)
    return replace(torso, lump_centre=centre, lump_radius=radius)

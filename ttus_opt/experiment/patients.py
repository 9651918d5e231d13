"""Three phantom patients of different build, stiffness, ribs and lumps, and recordings.

Two have superelliptic cross-sections. The third has the skin of a given scan, otherwise
the mean of the others' shapes. Tissue is linear elastic; the moduli are those of
relaxed to tense muscle and fat (15 to 32 kPa). Ribs are ten times as stiff, so that
they feel rigid to a probe.

Recordings are simulated once and cached in a folder. Every recording has three
versions: measured (reported poses, noisy wrench), true (true poses, true wrench), and
as the phantom itself would render it (true wrench at the reported poses). The last has
no model error: its difference from the measured wrench is due to noise alone, a lower
limit for every model.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from ttus_opt.core import io
from ttus_opt.phantom.elasticity import SkinPatch, skin_compliance
from ttus_opt.phantom.examination import Handling, push_handling, sweep_handling
from ttus_opt.phantom.press import CoulombDrag
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.recording import add_noise, add_pose_noise, record
from ttus_opt.phantom.torso import ScannedTorso, Torso, TorsoMesh, torso_body
from ttus_opt.probe.trajectory import Trajectory, read_trajectory
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
        return self.torso.surface(180, 61)

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


#: Ends of file names: measured, true, and the phantom at the reported poses
KINDS = ("", "_true", "_itself")

#: Files of a patient, beside the skin's compliance
FILES = ("surface.nc", *(f"{name}{kind}.csv" for name in RECORDINGS for kind in KINDS))

#: Digits of the files' numbers: below a nanometre and a micronewton
DIGITS = 8


@dataclass(frozen=True)
class Examination:
    """A patient's surface and recordings.

    Attributes:
        patient: The patient.
        surface: The true skin.
        measured: Reported poses with noisy wrenches, by name.
        true: True poses with true wrenches.
        itself: Reported poses with the phantom's true wrenches there.
    """

    patient: Patient
    surface: Surface = field(repr=False)
    measured: Mapping[str, Trajectory] = field(repr=False)
    true: Mapping[str, Trajectory] = field(repr=False)
    itself: Mapping[str, Trajectory] = field(repr=False)


def examine(
    patient: Patient,
    folder: Path,
    resolution: float,
    progress: Callable[[str], None] | None = None,
) -> Examination:
    """Simulate a patient's recordings, or read them from the cache.

    Args:
        patient: The patient.
        folder: The cache; created if missing.
        resolution: Resolution of the finite elements, see `phantom.torso.TorsoMesh`.
        progress: Called with every stage that begins.

    Raises:
        MissingPackageError: scikit-fem is not installed, and there is no cache.
        GeometryError: A path leaves the meshed skin.
    """
    begin = progress or (lambda stage: None)
    stamp, digest = folder / "digest.txt", patient.digest(resolution)
    kept = stamp.read_bytes() if stamp.exists() else b""
    there = all((folder / name).exists() for name in FILES)
    if not there or kept != digest.encode():
        # the stamp is written only when all recordings are complete
        stamp.unlink(missing_ok=True)
        begin(f"{patient.name}: finite elements")
        patch = _skin(patient, folder, resolution)
        begin(f"{patient.name}: recordings")
        patient.surface().save(folder / "surface.nc")
        for name in RECORDINGS:
            _record(patient, name, patch, folder)
        io.write_text(stamp, digest)
    kinds = (
        {name: read_trajectory(folder / f"{name}{kind}.csv") for name in RECORDINGS}
        for kind in KINDS
    )
    return Examination(patient, Surface.load(folder / "surface.nc"), *kinds)


def skin_file(patient: Patient, folder: Path, resolution: float) -> Path:
    """The file of the skin's compliance, which does not depend on the paths."""
    skin = patient.surface().radius.round(7).tobytes()
    text = repr((patient.torso, patient.mesh(resolution))).encode()
    return folder / f"skin-{hashlib.sha256(text + skin).hexdigest()[:12]}.npz"


def _skin(patient: Patient, folder: Path, resolution: float) -> SkinPatch:
    file = skin_file(patient, folder, resolution)
    if file.exists():
        return SkinPatch.load(file)
    patch = skin_compliance(torso_body(patient.torso, patient.mesh(resolution)))
    patch.save(file)
    return patch


def _record(patient: Patient, name: str, patch: SkinPatch, folder: Path) -> None:
    """Simulate one recording and write its three files."""
    rng = np.random.default_rng(patient.seed + RECORDINGS[name] + 1)
    drag = CoulombDrag(patient.drag)
    true = record(patch, PROBE, patient.poses(name), drag=drag, damping=patient.damping)
    reported = add_pose_noise(true, rng)
    # reported poses with the velocities of the true ones: tracker noise is not motion
    itself = record(
        patch, PROBE, reported, drag=drag, damping=patient.damping, moving=true
    )
    recordings = (add_noise(reported, rng), true, itself)
    for kind, recording in zip(KINDS, recordings, strict=True):
        recording.save(folder / f"{name}{kind}.csv", digits=DIGITS)

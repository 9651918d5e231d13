"""Recordings of a phantom patient, simulated once and cached in a folder.

Every recording has three versions: measured (reported poses, noisy wrench), true (true
poses, true wrench), and as the phantom itself would render it (true wrench at the
reported poses). The last has no model error: its difference from the measured wrench is
due to noise alone, a lower limit for every model.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ttus_opt.core import io
from ttus_opt.experiment.patients import PROBE, RECORDINGS, Patient
from ttus_opt.phantom.elasticity import SkinPatch, skin_compliance
from ttus_opt.phantom.press import CoulombDrag
from ttus_opt.phantom.recording import add_noise, add_pose_noise, record
from ttus_opt.phantom.torso import torso_body
from ttus_opt.probe.trajectory import Trajectory, read_trajectory
from ttus_opt.scan.surface import Surface

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

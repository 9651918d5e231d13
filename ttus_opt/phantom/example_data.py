"""The bundled example: its torso, cameras, paths and random seeds."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from ttus_opt.core import io
from ttus_opt.core.arrays import Array
from ttus_opt.phantom.camera import ScanSetup, View, scan, write_cloud
from ttus_opt.phantom.elasticity import SkinPatch, skin_compliance
from ttus_opt.phantom.examination import push_handling, sweep_handling
from ttus_opt.phantom.press import CoulombDrag
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.recording import add_noise, record
from ttus_opt.phantom.torso import Torso, TorsoMesh, torso_body
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.scan.frame import Axis
from ttus_opt.scan.surface import Surface

TORSO = Torso()
PROBE = EllipsoidProbe((0.030, 0.0125, 0.018))
VIEWS = (
    View((-0.55, 0.75, 0.15), opening=0.30, pixels=96),
    View((0.55, 0.75, 0.15), opening=0.30, pixels=96),
)
#: Friction coefficient of the recordings with drag [–]
DRAG = 0.25
#: Spacing of the mesh of ``skin.npz`` over that of the recordings [–]
COARSER = 2.0
#: Random seeds of the scan and of each recording's path; its noise uses the next seed
SCAN_SEED = 7
RECORDINGS = {
    "press_fit": 100,
    "press_test": 200,
    "sweep_fit": 300,
    "sweep_test": 400,
    "sweep_drag_fit": 500,
    "sweep_drag_test": 600,
}


def frame() -> Axis:
    """The patient frame in the scan frame, as a camera above would see it."""
    rotation = Rotation.from_euler("xyz", [100.0, 12.0, -75.0], degrees=True)
    return Axis(np.array([0.06, -0.04, 0.82]), np.asarray(rotation.as_matrix()))


def true_surface() -> Surface:
    """The torso's skin at 3° by 10 mm; bilinear interpolation is exact to 0.1 mm."""
    return TORSO.surface(120, 31, frame())


def cloud() -> Array:
    """The scan of torso and table, scan frame, shape (n, 3) [m]."""
    rng = np.random.default_rng(SCAN_SEED)
    return frame().to_scan(scan(ScanSetup(TORSO), VIEWS, rng))


def poses(name: str) -> Trajectory:
    """The path of one of `RECORDINGS`, without a wrench."""
    rng = np.random.default_rng(RECORDINGS[name])
    test = name.endswith("test")
    if name.startswith("press"):
        return push_handling(rng).poses(TORSO, PROBE)
    across = 0.006 if test else -0.006
    return sweep_handling(rng, across=across).poses(TORSO, PROBE)


def recording(
    name: str,
    patch: SkinPatch,
    *,
    n_frames: int | None = None,
    progress: Callable[[], None] | None = None,
) -> Trajectory:
    """One of `RECORDINGS` with its noisy wrench.

    Args:
        name: Name of the recording.
        patch: The torso's skin.
        n_frames: Number of first frames to record; they equal those of the whole
            recording, except for the last one's velocity and hence drag.
        progress: Called after every pose.
    """
    path = poses(name)
    if n_frames is not None:
        path = path.select(slice(n_frames))
    drag = CoulombDrag(DRAG) if "drag" in name else None
    true = record(patch, PROBE, path, drag=drag, progress=progress)
    return add_noise(true, np.random.default_rng(RECORDINGS[name] + 1))


def write_skin(path: Path) -> None:
    """Write the compliance of a torso on a coarser mesh: a patient for simulations."""
    body = torso_body(TORSO, TorsoMesh(resolution=COARSER))
    patch = skin_compliance(body)
    lower = np.tril_indices(len(patch.points))
    with io.replacing(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(
            file,
            points=patch.points.astype(np.float32),
            normals=patch.normals.astype(np.float32),
            rim=patch.rim,
            compliance=patch.compliance[lower].astype(np.float32),
        )


def write_example(
    folder: Path, patch: SkinPatch, progress: Callable[[], None] | None = None
) -> None:
    """Write every file of the example.

    Args:
        folder: Output folder, created if missing.
        patch: The torso's skin.
        progress: Called after every pose.
    """
    write_cloud(cloud(), folder / "scan.ply")
    true_surface().save(folder / "surface.nc")
    for name in RECORDINGS:
        recorded = recording(name, patch, progress=progress)
        recorded.save(folder / f"{name}.csv", digits=7)

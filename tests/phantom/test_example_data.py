import numpy as np
import pytest

from ttus_opt.phantom.example_data import (
    PROBE,
    RECORDINGS,
    TORSO,
    cloud,
    frame,
    poses,
    recording,
    true_surface,
    write_example,
)
from ttus_opt.phantom.recording import record


def test_surface_is_the_torso_within_a_tenth_of_a_millimetre():
    surface = true_surface()
    rng = np.random.default_rng(0)
    theta, z = rng.uniform(0, 2 * np.pi, 5000), rng.uniform(0, TORSO.length, 5000)
    error = surface.radius_at(theta, z) - TORSO.radius(theta, z)
    assert np.abs(error).max() < 1e-4


@pytest.mark.slow
def test_cloud_lies_in_the_scan_frame():
    points = frame().to_patient(cloud())
    z = points[:, 2]
    body = (points[:, 1] > -0.10) & (z > 0.0) & (z < TORSO.length)
    theta = np.arctan2(points[body, 1], points[body, 0])
    error = np.hypot(*points[body, :2].T) - TORSO.radius(theta, z[body])
    assert np.median(np.abs(error)) < 0.002
    assert body.sum() > 3000


def test_paths_of_fit_and_test_differ():
    for kind in ("press", "sweep", "sweep_drag"):
        gap = poses(f"{kind}_fit").position - poses(f"{kind}_test").position
        assert np.linalg.norm(gap, axis=1).mean() > 0.005


def test_recording_is_the_record_with_noise_and_drag_where_named(coarse_patch):
    for name in ("sweep_fit", "sweep_drag_fit"):
        noisy = recording(name, coarse_patch, n_frames=30)
        clean = record(coarse_patch, PROBE, poses(name).select(slice(30)))
        rest = noisy.force - clean.force
        if "drag" in name:
            assert np.abs(rest).max() > 0.5
        else:
            assert rest.std() == pytest.approx(0.08, rel=0.25)


@pytest.mark.slow
def test_write_example_writes_every_file_and_counts_poses(coarse_patch, tmp_path):
    count = []
    write_example(tmp_path, coarse_patch, lambda: count.append(1))
    names = {f"{name}.csv" for name in RECORDINGS} | {"scan.ply", "surface.nc"}
    assert {p.name for p in tmp_path.iterdir()} == names
    assert len(count) == 400 * len(RECORDINGS)

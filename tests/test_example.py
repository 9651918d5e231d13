import itertools

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, refuses
from ttus_opt import example
from ttus_opt.phantom.elasticity import skin_compliance
from ttus_opt.phantom.example_data import (
    DRAG,
    PROBE,
    RECORDINGS,
    TORSO,
    cloud,
    poses,
    recording,
    true_surface,
)
from ttus_opt.phantom.torso import torso_body


def test_every_named_file_is_there_and_nothing_else():
    folder = example.path("surface.nc").parent
    found = {
        p.name for p in folder.iterdir() if p.suffix in (".csv", ".nc", ".npz", ".ply")
    }
    assert found == set(example.NAMES)
    assert set(RECORDINGS) == {n[:-4] for n in example.NAMES if n.endswith(".csv")}
    assert sum(example.path(n).stat().st_size for n in example.NAMES) < 900_000


def test_unknown_name_is_refused_with_the_choices():
    refuses(InputError, r"choose one of scan\.ply", example.path, "scan.pcd")


def test_probe_and_drag_are_those_of_the_physics():
    semi = tuple(float(v) for v in example.PROBE.removeprefix("ellipsoid:").split(","))
    assert semi == PROBE.semi_axes
    assert example.DRAG == DRAG


@pytest.mark.slow
def test_surface_and_scan_are_what_the_phantom_makes():
    stored, made = tt.Surface.load(example.path("surface.nc")), true_surface()
    assert stored.radius == pytest.approx(made.radius, rel=1e-9)
    assert stored.axis.origin == pytest.approx(made.axis.origin)
    assert stored.axis.rotation == pytest.approx(made.axis.rotation)
    points = tt.read_cloud(example.path("scan.ply"), unit="m")
    assert points == pytest.approx(cloud(), abs=1e-6)


def test_scan_lies_on_the_surface_through_its_axis():
    surface = tt.Surface.load(example.path("surface.nc"))
    points = surface.axis.to_patient(tt.read_cloud(example.path("scan.ply"), unit="m"))
    inside = (points[:, 2] > 0.0) & (points[:, 2] < TORSO.length)
    body = points[inside & (points[:, 1] > -0.10)]
    radius = surface.radius_at(np.arctan2(body[:, 1], body[:, 0]), body[:, 2])
    assert np.median(np.abs(np.hypot(body[:, 0], body[:, 1]) - radius)) < 0.002


@pytest.mark.parametrize("name", RECORDINGS)
def test_recordings_are_rich(name):
    recorded = tt.read_trajectory(example.path(f"{name}.csv"))
    assert len(recorded) == 400
    assert np.diff(recorded.time) == pytest.approx(0.05)
    assert recorded.position == pytest.approx(poses(name).position, abs=1e-7)
    force = np.linalg.norm(recorded.force, axis=1)
    assert 5.0 < force.max() < 12.0
    if name.startswith("press"):
        assert 0.1 < (force < 0.3).mean() < 0.5  # lifted off now and then
    else:
        assert np.ptp(recorded.position[:, 2]) > 0.10
    assert np.linalg.norm(recorded.torque, axis=1).max() > 0.015


def test_no_two_recordings_are_the_same():
    forces = [tt.read_trajectory(example.path(f"{n}.csv")).force for n in RECORDINGS]
    for a, b in itertools.combinations(forces, 2):
        assert np.abs(a - b).mean() > 0.05


@pytest.mark.slow
@pytest.mark.long
def test_bundled_recordings_can_be_made_again():
    patch = skin_compliance(torso_body(TORSO))
    for name in RECORDINGS:
        stored = tt.read_trajectory(example.path(f"{name}.csv"))
        made = recording(name, patch, n_frames=60)
        # The last velocity is one-sided when only a part is made.
        for wanted, found in ((stored.force, made.force), (stored.torque, made.torque)):
            assert found[:59] == pytest.approx(wanted[:59], rel=1e-5, abs=1e-6)

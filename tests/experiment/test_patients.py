from dataclasses import replace

import numpy as np
import pytest

from ttus_opt.experiment.patients import PROBE, RECORDINGS, patients
from ttus_opt.phantom.torso import Torso
from ttus_opt.scan.surface import Surface

EVERYONE = patients()


@pytest.mark.parametrize("patient", EVERYONE, ids=lambda p: p.name)
def test_paths_stay_on_the_skin_that_is_meshed(patient):
    mesh = patient.mesh(1.4)
    for name in RECORDINGS:
        path = patient.poses(name)
        assert len(path) == 400
        assert np.diff(path.time) == pytest.approx(0.05)
        x, y, z = path.position.T
        radius = patient.torso.radius(np.arctan2(y, x), z)
        assert (np.hypot(x, y) > radius).all()  # the probe's centre is above the skin
        assert (z > mesh.z[0]).all() and (z < mesh.z[1]).all()
        theta = np.arctan2(y, x)
        assert (theta > mesh.theta[0]).all() and (theta < mesh.theta[1]).all()


def test_fit_and_test_are_other_paths_and_patients_other_bodies():
    for patient in EVERYONE:
        for kind in ("press", "sweep"):
            fit, test = (patient.poses(f"{kind}_{use}") for use in ("fit", "test"))
            assert np.linalg.norm(fit.position - test.position, axis=1).mean() > 2e-3
    for name in ("soft", "rib", "rib_depth", "lump_radius", "half_axes"):
        assert len({getattr(p.torso, name) for p in EVERYONE}) >= 2
    assert len({p.torso.soft for p in EVERYONE}) == 3


def test_digest_changes_with_whatever_changes_a_recording():
    lean = EVERYONE[0]
    changed = [
        replace(lean, seed=1),
        replace(lean, drag=0.21),
        replace(lean, torso=replace(lean.torso, soft=31e3)),
        replace(lean, torso=replace(lean.torso, swell=0.031)),
    ]
    digests = {p.digest(1.4) for p in (lean, *changed)} | {lean.digest(1.5)}
    assert len(digests) == 6
    assert lean.digest(1.4) == patients()[0].digest(1.4)


def test_third_patient_has_the_skin_of_a_scan():
    shape = Torso(half_axes=(0.18, 0.13))
    theta = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    z = np.linspace(-0.16, 0.16, 41)
    scan = Surface.from_radius(shape.radius(theta[:, None], z + 0.16), z)
    scanned = patients(scan)[2]
    assert scanned.name == "scanned"
    front = scanned.torso.radius(np.array(np.pi / 2), np.array(0.15))
    assert front == pytest.approx(0.13, rel=0.05)
    lump = np.asarray(scanned.torso.lump_centre)
    assert PROBE.semi_axes == (0.030, 0.0125, 0.018)
    assert 0.09 < np.hypot(*lump[:2]) < front  # below this skin, not the made-up one's


@pytest.mark.parametrize("patient", EVERYONE, ids=lambda p: p.name)
def test_surface_is_the_torsos_skin_between_its_nodes_too(patient):
    rng = np.random.default_rng(2)
    theta, z = rng.uniform(0.0, 6.28, 500), rng.uniform(0.0, patient.torso.length, 500)
    off = patient.surface().radius_at(theta, z) - patient.torso.radius(theta, z)
    assert np.abs(off).max() < 1e-4

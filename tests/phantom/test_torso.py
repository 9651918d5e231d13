import numpy as np
import pytest

from tests.refusals import refuses
from ttus_opt.core.errors import GeometryError
from ttus_opt.phantom import Torso, TorsoMesh, press, skin_compliance, torso_body
from ttus_opt.phantom.example_data import PROBE, poses


def test_skin_and_normals_of_an_elliptic_cylinder():
    torso = Torso(exponent=2.0, swell=0.0)
    theta, z = np.linspace(0, 6, 50), np.full(50, 0.1)
    a, b = torso.half_axes
    x, y, height = torso.skin(theta, z).T
    assert (x / a) ** 2 + (y / b) ** 2 == pytest.approx(1.0)
    assert np.array_equal(height, z)
    expected = np.stack([x / a**2, y / b**2, 0 * x], axis=1)
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    assert torso.normals(theta, z) == pytest.approx(expected, abs=1e-7)


def test_tissue_is_soft_at_the_skin_and_stiff_in_ribs_and_lump():
    torso = Torso()
    assert torso.young(np.array(torso.lump_centre)) == pytest.approx(torso.lump, 0.01)
    theta = np.full(400, np.pi / 2)
    z = np.linspace(0.0, torso.length, 400)
    skin = torso.skin(theta, z)
    assert torso.young(skin.T) == pytest.approx(torso.soft, rel=1e-3)
    middle = skin - sum(torso.rib_depth) / 2 * np.array([0.0, 1.0, 0.0])
    young = torso.young(middle.T)
    ribs = np.diff((young > 0.5 * (torso.soft + torso.rib)).astype(int)) == 1
    expected = (torso.length - torso.rib_from) / torso.rib_pitch
    assert ribs.sum() == pytest.approx(expected, abs=1)
    assert young[(z < torso.rib_from - 0.005) & (z > 0.13)].max() < 1.1 * torso.soft


def test_mesh_has_its_patch_on_the_skin_and_a_rim_around_it(coarse_body):
    torso, spec = Torso(), TorsoMesh()
    points = coarse_body.mesh.p.T[coarse_body.patch]
    theta = np.arctan2(points[:, 1], points[:, 0])
    assert np.hypot(points[:, 0], points[:, 1]) == pytest.approx(
        torso.radius(theta, points[:, 2])
    )
    for value, limits in ((theta, spec.theta), (points[:, 2], spec.z)):
        assert (value.min(), value.max()) == pytest.approx(limits)
    n_theta, n_z = (len(np.unique(v.round(9))) for v in (theta, points[:, 2]))
    assert len(points) == n_theta * n_z
    assert coarse_body.rim.sum() == 2 * (n_theta + n_z) - 4


def test_core_and_back_are_held_and_the_ends_slide(coarse_body):
    x, y, z = coarse_body.mesh.p
    torso = Torso()
    radius = np.hypot(x, y)
    assert coarse_body.fixed[radius < torso.core_radius + 1e-9].all()
    end = (z == 0.0) | (z == torso.length)
    assert coarse_body.fixed[end, 2].all()
    free = (radius > 0.06) & (y > 0.0)
    assert not coarse_body.fixed[free & ~end].any()
    assert not coarse_body.fixed[free & end, :2].any()


def relative_difference(coarse, fine):
    """Relative difference of the force over presses of more than 1 N."""
    found = []
    for name in ("press_fit", "sweep_fit"):
        path = poses(name)
        for m in range(0, len(path), 5):
            a, b = (
                np.linalg.norm(
                    press(p, PROBE, path.rotation[m], path.position[m]).force
                )
                for p in (coarse, fine)
            )
            if b > 1.0:
                found.append(a / b - 1.0)
    assert len(found) > 50
    return np.sqrt(np.mean(np.square(found)))


@pytest.mark.slow
@pytest.mark.long
def test_refinement_closes_in():
    coarse, middle, fine = (
        skin_compliance(torso_body(Torso(), TorsoMesh(resolution=r)))
        for r in (2.0, 1.4, 1.0)
    )
    assert relative_difference(coarse, fine) < 0.05
    assert relative_difference(middle, fine) < 0.03


def test_refuses_a_core_that_reaches_the_skin():
    refuses(GeometryError, "core_radius", torso_body, Torso(core_radius=0.11))

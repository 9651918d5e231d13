"""Simulated and scanned torsos, and their mesh."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.kit import GeometryError, InputError, refuses
from tests.phantom.block import box_mesh
from ttus_opt.phantom.elasticity import skin_compliance
from ttus_opt.phantom.example_data import PROBE, poses
from ttus_opt.phantom.press import press
from ttus_opt.phantom.torso import (
    ScannedTorso,
    Torso,
    TorsoMesh,
    graded,
    ring_mesh,
    torso_body,
)
from ttus_opt.scan.surface import Surface


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


def volume(mesh):
    from skfem import Basis, ElementHex1

    return float(Basis(mesh, ElementHex1(), intorder=3).dx.sum())


#: Beside the fine part: none, or more than the rounding of its ends
_MARGIN = st.just(0.0) | st.floats(1e-6, 5)


@settings(max_examples=60)
@given(
    low=st.floats(-10, 0),
    left=_MARGIN,
    width=st.floats(0.5, 5),
    right=_MARGIN,
    step=st.floats(0.05, 0.5),
    growth=st.floats(1.05, 2.0),
)
def test_graded_nodes_span_the_interval_and_grow_smoothly(
    low, left, width, right, step, growth
):
    fine = (low + left, low + left + width)
    nodes = graded(low, fine[1] + right, fine, step, growth)
    steps = np.diff(nodes)
    assert nodes[0] == low and nodes[-1] == fine[1] + right
    assert (steps > 0.0).all()
    inside = (nodes[:-1] >= fine[0] - 1e-9) & (nodes[1:] <= fine[1] + 1e-9)
    assert np.ptp(steps[inside]) < 1e-9
    assert steps[inside].mean() <= 1.6 * step


def test_ring_is_closed_and_has_the_volume_of_a_pipe():
    def pipe(f, theta, z):
        r = 1.0 + f
        return np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1)

    theta = np.linspace(0.3, 0.3 + 2 * np.pi, 65)
    mesh = ring_mesh(np.linspace(0, 1, 4), theta, np.linspace(0, 2, 3), pipe)
    assert mesh.p.shape == (3, 4 * 64 * 3)
    # A regular 64-gon instead of the circle.
    polygon = 32 * np.sin(2 * np.pi / 64)
    assert volume(mesh) == pytest.approx((4 - 1) * polygon * 2.0, rel=1e-9)
    # Faces on the outside only: inner, outer and two ends, none at the seam.
    assert len(mesh.boundary_facets()) == 2 * 64 * 2 + 2 * 64 * 3


def test_box_has_its_volume():
    mesh = box_mesh(np.array([0.0, 1, 3]), np.array([0.0, 2]), np.array([0.0, 1, 2]))
    assert volume(mesh) == pytest.approx(12.0)


def test_refuses_bad_gradings_and_open_rings():
    refuses(InputError, "cannot grade", graded, 0.0, 1.0, (0.5, 2.0), 0.1)
    refuses(InputError, "cannot grade", graded, 0.0, 1.0, (0.2, 0.5), 0.0)
    with pytest.raises(InputError, match="full turn"):
        ring_mesh(np.arange(3.0), np.linspace(0, 6, 9), np.arange(3.0), None)


def surface_of(torso, length=0.32, n_z=41):
    theta = np.linspace(0.0, 2.0 * np.pi, 120, endpoint=False)
    z = np.linspace(0.0, length, n_z)
    return Surface.from_radius(torso.radius(theta[:, None], z), z - 0.1)


def test_shape_is_that_of_the_scan_and_tissue_that_of_the_torso():
    shape, tissue = Torso(swell=0.03), Torso(soft=33e3, half_axes=(0.2, 0.2))
    torso = ScannedTorso.of(surface_of(shape), tissue)
    theta, z = np.linspace(0.0, 6.2, 37), np.linspace(0.02, 0.28, 37)
    # smoothing a slow swell over 6 mm along z: below a tenth of a millimetre
    assert torso.radius(theta, z) == pytest.approx(shape.radius(theta, z), abs=1e-4)
    assert torso.soft == 33e3
    assert torso.half_axes == pytest.approx(shape.half_axes, rel=0.05)


def test_radius_closes_around_the_body_with_its_slope():
    rng = np.random.default_rng(1)
    z = np.linspace(0.0, 0.3, 31)
    surface = Surface.from_radius(0.12 + 0.003 * rng.standard_normal((120, 31)), z)
    torso = ScannedTorso.of(surface, Torso())
    h, height = 1e-4, np.full(5, 0.11)
    around = torso.radius(np.array([-2, -1, 0, 1, 2]) * h, height)
    third = np.diff(around, 3)
    assert np.abs(third).max() < 1e-9  # a kink of 1 mm/rad would be 1e-7


def test_refuses_a_scan_that_is_too_short_or_none():
    with pytest.raises(GeometryError, match="longer scan"):
        ScannedTorso.of(surface_of(Torso(), length=0.2), Torso())
    refuses(InputError, "no surface", ScannedTorso().radius, np.zeros(1), np.zeros(1))

"""Touch never pulls: straight presses over grids, samplings, fields and surfaces."""

import functools
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import ellipsoid, shared_data
from ttus_opt import example
from ttus_opt.contact.rows import contact_rows

SAMPLINGS = ["voxel-mean", "trilinear"]
GRIDS = {
    "coarse": (12, 32, 16),
    "S": (24, 72, 30),
    "anisotropic": (40, 36, 12),
    "M": (48, 120, 60),
}
PLACES = [(angle, share) for angle in (0.5, 1.1, 1.7, 2.5) for share in (0.35, 0.6)]


def shell():
    return ellipsoid(1500, (0.030, 0.0125, 0.018))


@dataclass(frozen=True)
class Fields:
    """One grid over one surface, with the fields to press on, flat."""

    voxmap: tt.Voxmap
    sampling: str
    laplace: np.ndarray
    eq10: np.ndarray


@functools.cache
def fields(folder, shape, sampling):
    voxmap = tt.Voxmap.from_surface(tt.Surface.load(folder / "surface.nc"), shape=shape)
    trajectory = tt.read_trajectory(folder / "press_fit.csv")
    scene = tt.Scene.assemble(
        voxmap, shell(), trajectory, inner="fit", sampling=sampling
    )
    fitted = tt.fit(scene, "eq10", force_weight=1e-2, torque_weight=1e-2)
    laplace = scene.laplace.solve(scene.b)
    return Fields(voxmap, sampling, laplace, fitted.field.values.reshape(-1))


@dataclass(frozen=True)
class Press:
    """Straight presses of the probe's long axis, at some places, patient frame."""

    inward: np.ndarray  # (n, 3)
    rotation: np.ndarray  # (n, 3, 3)
    skin: np.ndarray  # (n, 3) where the tip meets it

    @classmethod
    def of(cls, surface, places):
        angle, share = np.array(places).T
        z = surface.z[0] + share * (surface.z[-1] - surface.z[0])
        out = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
        across = np.stack([-np.sin(angle), np.cos(angle), 0 * angle], axis=1)
        up = np.broadcast_to([0.0, 0.0, 1.0], out.shape)
        skin = surface.radius_at(angle, z)[:, None] * out + z[:, None] * up
        return cls(-out, np.stack([out, across, up], axis=2), skin)

    def rows(self, at, depth):
        """Rows for tips at depths (n, t) [m] below the skin."""
        centre = self.skin[:, None] + (depth[..., None] - 0.030) * self.inward[:, None]
        return contact_rows(
            at.voxmap,
            shell(),
            np.repeat(self.rotation, depth.shape[1], axis=0),
            centre.reshape(-1, 3),
            sampling=at.sampling,
        )

    def push(self, rows, p):
        """Force out of the patient, (n, t) [N]."""
        force = (rows.N @ p).reshape(len(self.inward), -1, 3)
        return np.asarray(-np.einsum("nti,ni->nt", force, self.inward))


def depths(n_places, low, high, n):
    return np.tile(np.linspace(low, high, n), (n_places, 1))


def surface_folder(name):
    if name == "example":
        return Path(example.path("surface.nc")).parent
    return shared_data(name)


CASES = [
    pytest.param(name, grid, marks=pytest.mark.slow if grid in "SM" else ())
    for name, grids in (("example", GRIDS), ("phantom_frictionless", ["coarse", "S"]))
    for grid in grids
]


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize(("name", "grid"), CASES)
def test_a_straight_press_never_pulls(name, grid, sampling):
    """It once pulled by 2 N on the coarse grid, 8 N with voxel means."""
    at = fields(surface_folder(name), GRIDS[grid], sampling)
    press = Press.of(at.voxmap.surface, PLACES)
    rows = press.rows(at, depths(len(PLACES), -0.004, 0.006, 101))
    touched = rows.contact_points.reshape(len(PLACES), -1) > 0
    laplace, fitted = press.push(rows, at.laplace), press.push(rows, at.eq10)
    assert touched.any(axis=1).all()
    assert laplace.min() > -1e-9
    # no sign is asked of a fit: what it may pull is what lies below zero in it
    assert fitted.min() > -1e-3
    if sampling == "trilinear":
        assert (laplace[:, -1] > 0.1).all()
        assert (np.diff(laplace, axis=1) > -1e-9).all()  # grows with depth


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize(("name", "grid"), CASES)
def test_force_starts_from_zero(name, grid, sampling):
    """At the very depth of first touch, found by bisection."""
    at = fields(surface_folder(name), GRIDS[grid], sampling)
    press = Press.of(at.voxmap.surface, PLACES)
    air, touching = np.full((len(PLACES), 1), -0.03), np.full((len(PLACES), 1), 0.002)
    for _ in range(28):  # 32 mm to 0.1 nm
        middle = (air + touching) / 2
        touched = press.rows(at, middle).contact_points[:, None] > 0
        air = np.where(touched, air, middle)
        touching = np.where(touched, middle, touching)
    rows = press.rows(at, touching)
    assert (rows.contact_points > 0).all()
    for p in (at.laplace, at.eq10):
        assert np.abs(press.push(rows, p)).max() < 1e-5


@pytest.mark.parametrize("sampling", SAMPLINGS)
@pytest.mark.parametrize("r_inner", [0.10, 0.03])
def test_beyond_the_inner_layer_the_force_keeps_its_direction(r_inner, sampling):
    """It once fell from 62 N to −155 N when the inner layer was passed."""
    folder = surface_folder("example")
    surface = tt.Surface.load(folder / "surface.nc")
    voxmap = tt.Voxmap.from_surface(surface, shape=(24, 72, 30), r_inner=r_inner)
    trajectory = tt.read_trajectory(folder / "press_fit.csv")
    scene = tt.Scene.assemble(
        voxmap, shell(), trajectory, inner="fit", sampling=sampling
    )
    p = scene.laplace.solve(scene.b)
    at = Fields(voxmap, sampling, p, p)
    press = Press.of(surface, [(1.6, 0.5)])
    # with voxel means no deeper: of what lies beyond, a spoke has but one voxel
    deepest = 0.03 if r_inner > 0.05 else 0.095
    jumps = []
    for n in (221, 441):
        depth = depths(1, 0.001, deepest, n)
        rows = press.rows(at, depth)
        force = (rows.N @ p).reshape(-1, 3)
        push = press.push(rows, p)[0]
        jumps.append(np.abs(np.diff(push)).max())
        deep = depth[0] > 0.012
        assert (push >= 0.0).all()
        assert (push[deep] > 1.0).all()
        aside = push[deep] / np.linalg.norm(force[deep], axis=1)
        assert np.degrees(np.arccos(aside)).max() < 25.0
    if sampling == "trilinear":
        assert jumps[1] < 0.55 * jumps[0]
    centre = press.skin + (depth[0][:, None] - 0.03) * press.inward
    points = (shell().points @ press.rotation[0].T)[None] + centre[:, None]
    beyond = (np.hypot(points[..., 0], points[..., 1]) < r_inner).sum(axis=1)
    np.testing.assert_array_equal(rows.beyond_inner, beyond)
    assert beyond[0] == 0
    assert beyond[-1] > 50
    field = tt.PotentialField(voxmap, p.reshape(voxmap.grid.shape), sampling)
    renderer = tt.Renderer(field, shell(), force_limit=np.inf, torque_limit=np.inf)
    for t in range(0, len(centre), 40):
        wrench = renderer.render(press.rotation[0], centre[t])
        assert wrench.beyond_inner == beyond[t]
        np.testing.assert_allclose(wrench.force, force[t], rtol=0, atol=1e-10)

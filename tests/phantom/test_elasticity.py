import dataclasses

import numpy as np
import pytest
from scipy.sparse.linalg import spsolve

from tests.kit import FileError, InputError, refuses
from tests.phantom.block import box_mesh
from ttus_opt.phantom import elasticity
from ttus_opt.phantom.elasticity import ElasticBody, SkinPatch, skin_compliance


def column(poisson, young=2e4):
    """A bar of 1 x 1 x 4 m on rollers, loaded on all of its top nodes."""
    n = np.linspace(0.0, 1.0, 4)
    mesh = box_mesh(n, n, np.linspace(-4.0, 0.0, 9))
    x, y, z = mesh.p
    fixed = np.stack([x == 0.0, y == 0.0, z == -4.0], axis=1)
    patch = np.flatnonzero(z == 0.0)
    normals = np.tile([0.0, 0.0, 1.0], (len(patch), 1))
    rim = np.zeros(len(patch), dtype=bool)
    return ElasticBody(
        mesh, lambda p: np.full(p.shape[1:], young), poisson, fixed, patch, normals, rim
    )


def shortening(body):
    """Of a column under 1 Pa: nodal loads are the tributary areas of its top."""
    x, y = body.mesh.p[:2, body.patch]
    edge = 1.0 / 3.0
    areas = np.where((x == 0) | (x == 1), edge / 2, edge)
    areas = areas * np.where((y == 0) | (y == 1), edge / 2, edge)
    return skin_compliance(body).compliance @ areas


@pytest.mark.parametrize("poisson", [0.0, 0.3, 0.45, 0.499])
def test_a_column_shortens_as_hooke_says(poisson):
    assert shortening(column(poisson)) == pytest.approx(4.0 / 2e4, rel=1e-9)


def test_confined_column_has_the_oedometric_modulus():
    body = column(0.45)
    fixed = body.fixed.copy()
    fixed[:, :2] = True
    modulus = 2e4 * 0.55 / (1.45 * 0.10)
    confined = shortening(dataclasses.replace(body, fixed=fixed))
    assert confined == pytest.approx(4.0 / modulus, rel=1e-9)


@pytest.mark.slow
def test_compliance_is_symmetric_positive_definite(coarse_patch):
    c = coarse_patch.compliance
    assert np.abs(c - c.T).max() < 1e-11 * c.max()
    assert np.linalg.eigvalsh(c).min() > 1e-3 * np.linalg.eigvalsh(c).max() / len(c)


@pytest.mark.slow
def test_ribs_and_lump_make_the_skin_stiffer(coarse_body, coarse_patch):
    soft = dataclasses.replace(coarse_body, young=lambda p: np.full(p.shape[1:], 20e3))
    difference = skin_compliance(soft).compliance - coarse_patch.compliance
    # Stiffening any part can only lower the energy u·f of a load.
    assert np.linalg.eigvalsh(0.5 * (difference + difference.T)).min() > -1e-9
    assert difference.trace() > 0.01 * coarse_patch.compliance.trace()


@pytest.mark.slow
def test_saved_and_loaded_patch_is_the_same(coarse_patch, tmp_path):
    file = tmp_path / "skin.npz"
    coarse_patch.save(file)
    loaded = SkinPatch.load(file)
    for name in ("points", "normals", "rim", "compliance"):
        assert np.array_equal(getattr(loaded, name), getattr(coarse_patch, name))


def test_refuses_files_that_are_no_patch(tmp_path):
    file = tmp_path / "skin.npz"
    file.write_bytes(b"not a zip")
    refuses(FileError, "not a stored compliance", SkinPatch.load, file)
    refuses(FileError, "not found", SkinPatch.load, tmp_path / "none.npz")
    np.savez_compressed(file, points=np.arange(3000.0).reshape(-1, 3))
    whole = file.read_bytes()
    damaged = [whole[:2000], whole[:500] + b"\0" * 500 + whole[1000:], whole]
    np.save(tmp_path / "array.npy", np.zeros(3))
    for content in (*damaged, (tmp_path / "array.npy").read_bytes()):
        file.write_bytes(content)
        refuses(FileError, "not a stored compliance", SkinPatch.load, file)


def test_refuses_bodies_without_an_answer():
    body = column(0.3)
    refuses(InputError, "Poisson", dataclasses.replace, body, poisson=0.5)
    with pytest.raises(InputError, match="float"):
        dataclasses.replace(body, fixed=np.zeros_like(body.fixed))
    with pytest.raises(InputError, match="fixed must have shape"):
        dataclasses.replace(body, fixed=body.fixed[1:])
    refuses(InputError, "normals", dataclasses.replace, body, normals=body.normals[1:])


def test_progress_counts_every_load(monkeypatch):
    monkeypatch.setattr("ttus_opt.phantom.elasticity.BATCH", 5)
    calls = []
    body = column(0.3)
    skin_compliance(body, lambda done, total: calls.append((done, total)))
    assert len(calls) == 4
    assert calls[-1] == (len(body.patch),) * 2
    assert [c[0] for c in calls] == sorted(c[0] for c in calls)


def test_every_load_is_in_equilibrium_with_what_holds_the_body():
    """Forces and moments of load and reactions cancel; no rigid motion is resisted."""
    body = column(0.45)
    basis, stiffness = elasticity._assemble(body)
    at, dofs = body.mesh.p.T, np.asarray(basis.nodal_dofs).T  # (n, 3) both
    rng = np.random.default_rng(5)
    load = np.zeros(stiffness.shape[0])
    load[dofs[body.patch]] = rng.standard_normal((len(body.patch), 3))
    held = np.zeros(len(load), dtype=bool)
    held[dofs[body.fixed]] = True
    moved = np.zeros_like(load)
    moved[~held] = spsolve(stiffness[~held][:, ~held].tocsc(), load[~held])
    forces = (stiffness @ moved)[dofs]  # load where free, reaction where held
    assert forces[~body.fixed] == pytest.approx(load[dofs][~body.fixed], abs=1e-9)
    size = np.abs(forces).sum()
    assert np.abs(forces.sum(axis=0)).max() < 1e-11 * size
    assert np.abs(np.cross(at, forces).sum(axis=0)).max() < 1e-10 * size
    for turn in np.eye(3):
        rigid = np.zeros_like(load)
        rigid[dofs] = np.cross(turn, at) + turn
        assert np.abs(stiffness @ rigid).max() < 1e-10 * np.abs(stiffness).max()

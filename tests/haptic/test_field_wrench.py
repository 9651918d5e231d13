"""One wrench: what is judged, what is rendered and what is written are the same."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.drags import LAWS, SHELL, SURFACE, VOXMAP, pushing
from ttus_opt.cli import main
from ttus_opt.haptic.drag import DragLaw
from ttus_opt.haptic.field_wrench import wrenches_along


def motion(n=40):
    """In from the air, along and around the front with changes of speed, and out."""
    s = np.linspace(0.0, 1.0, n)
    angle = 1.4 + 0.4 * np.sin(5 * s)
    z = 0.1 + 0.06 * np.sin(9 * s)
    r = SURFACE.radius_at(angle, z) + 0.013 - 0.02 * np.sin(np.pi * s)
    centre = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    turns = np.stack([np.sin(4 * s), np.cos(3 * s), np.sin(6 * s)], axis=1)
    rotation = Rotation.from_rotvec(0.5 * turns).as_matrix()
    time = 0.05 * np.cumsum(1.0 + 0.5 * np.sin(np.arange(n)))
    return tt.Trajectory(time, centre - rotation @ SHELL.reference, rotation)


def rendered(field, trajectory):
    """Frame by frame with the trajectory's twists, shape (T, 6)."""
    renderer = tt.Renderer(field, SHELL)
    frames = zip(
        trajectory.rotation, trajectory.position, trajectory.twist(), strict=True
    )
    wrenches = [renderer.render(*frame) for frame in frames]
    expected = "given" if DragLaw.of(field.parameters, VOXMAP.grid).active else "none"
    assert {w.drag for w in wrenches} == {expected}
    return np.array([[*w.force, *w.torque] for w in wrenches])


@pytest.mark.parametrize("sampling", ["voxel-mean", "trilinear"])
@pytest.mark.parametrize("law", LAWS)
def test_frames_are_what_evaluate_judges(law, sampling):
    field, trajectory = pushing(sampling, LAWS[law]), motion()
    along = wrenches_along(field, SHELL, trajectory)
    found = rendered(field, trajectory)
    np.testing.assert_allclose(found[:, :3], along.force, rtol=0, atol=2e-11)
    np.testing.assert_allclose(found[:, 3:], along.torque, rtol=0, atol=1e-12)
    bare = wrenches_along(pushing(sampling, {}), SHELL, trajectory)
    added = np.linalg.norm(along.force - bare.force, axis=1)
    assert (added > 0.05).sum() > 15 or law == "none"
    assert np.linalg.norm(bare.force, axis=1).max() > 3.0


@pytest.mark.parametrize("law", ["none", "coulomb-reference", "viscous-regions"])
def test_the_command_writes_what_evaluate_judges(law, tmp_path):
    """The CSV of ``ttus-opt render`` against both series of an evaluation."""
    probe = "ellipsoid:0.02,0.015,0.012"
    shell = tt.PointShell.from_spec(probe, n_points=400)
    pushing("trilinear", LAWS[law]).save(tmp_path / "field.nc")
    motion().save(tmp_path / "poses.csv")
    arguments = ["--field", str(tmp_path / "field.nc"), "--probe", probe]
    arguments += ["--trajectory", str(tmp_path / "poses.csv"), "--points", "400"]
    out = tmp_path / "rendered.csv"
    with pytest.raises(SystemExit, match="0"):
        main(["render", *arguments, "-o", str(out), "--json"])
    written = tt.read_trajectory(out)
    judged = tt.evaluate(tt.PotentialField.load(tmp_path / "field.nc"), shell, written)
    np.testing.assert_allclose(written.force, judged.rendered_force, atol=1e-11)
    np.testing.assert_allclose(written.torque, judged.rendered_torque, atol=1e-12)
    assert judged.errors.force_vector_rmse_N < 1e-11
    assert judged.errors.frames_in_contact > 15


def test_evaluate_counts_points_beyond_the_inner_layer():
    shallow = tt.Voxmap.from_surface(SURFACE, shape=(8, 30, 14), r_inner=0.07)
    values = np.ones(shallow.grid.shape)
    field = tt.PotentialField(shallow, values, "trilinear")
    R, at = np.eye(3), np.array([0.0, 0.075, 0.1]) - SHELL.reference
    deep = tt.Trajectory(np.arange(1.0), at[None], R[None], at[None], at[None])
    found = tt.evaluate(field, SHELL, deep).beyond_inner
    points = SHELL.points + at
    inner = np.hypot(points[:, 0], points[:, 1]) < 0.07
    assert found[0] == inner.sum() > 10
    assert tt.Renderer(field, SHELL).render(R, at).beyond_inner == found[0]
    assert VOXMAP.grid.r_inner < 0.07

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, ellipsoid, presses, refuses, torso
from ttus_opt.contact import scene as scene_module
from ttus_opt.contact.point_drag import point_drag_rows
from ttus_opt.contact.scene import Scene, ScenePlan

SURFACE = torso()
VOXMAP = tt.Voxmap.from_surface(SURFACE, shape=(9, 20, 10))
SHELL = ellipsoid()
TRAJECTORY = presses(SURFACE, 12, np.random.default_rng(0))


def test_shapes(scene):
    V, T = scene.n_voxels, len(scene.trajectory)
    assert scene.L.shape == (V, V)
    assert scene.b.shape == (V,)
    assert scene.N.shape == scene.W.shape == (3 * T, V)
    assert scene.f.shape == scene.tau.shape == (3 * T,)
    np.testing.assert_array_equal(scene.f[3:6], scene.trajectory.force[1])
    assert scene.torque_length == scene.shell.rms_radius


@pytest.mark.parametrize("before", ["trilinear", "contact-size", "voxel-mean"])
@pytest.mark.parametrize("after", ["trilinear", "contact-size:0.012"])
def test_another_sampling_is_that_of_an_assembly(before, after):
    force = np.linspace(0.5, 3.0, 12)[:, None] * [-1.0, 0.2, 0.1]
    measured = replace(TRAJECTORY, force=np.abs(TRAJECTORY.position) * 30.0 * force)
    given = (VOXMAP, SHELL, measured)
    first = Scene.assemble(*given, inner=2.0, outer=3.0, sampling=before)
    _ = first.point_drag
    found = first.resampled(after)
    whole = Scene.assemble(*given, inner=2.0, outer=3.0, sampling=after)
    drag = point_drag_rows(*given, sampling=after)
    for mine, other in (
        (found.N, whole.N),
        (found.W, whole.W),
        (found.point_drag.force, drag.force),
        (found.point_drag.torque, drag.torque),
    ):
        scale = abs(other).max()
        assert scale > 0.0
        assert abs(mine - other).max() <= 1e-12 * scale
    assert (found.sampling, found.inner, found.outer) == (after, 2.0, 3.0)


def test_another_sampling_fits_a_fitted_scale_again(scene):
    fitted = {"inner": "fit", "outer": 0.75}
    given = (scene.voxmap, scene.shell, scene.trajectory)
    found = Scene.assemble(*given, **fitted).resampled("contact-size")
    whole = Scene.assemble(*given, **fitted, sampling="contact-size")
    assert found.parameters == pytest.approx(whole.parameters)
    assert found.standard_errors == pytest.approx(whole.standard_errors)
    np.testing.assert_allclose(found.b, whole.b)
    refuses(InputError, "sampling must be one of", found.resampled, "nearest")


def test_boundary_values_reach_b(scene):
    b = scene.voxmap.grid.unflatten(scene.b)
    skin = scene.voxmap.on_surface
    assert b[0, 0, 3] == 2.0
    assert b[-1, 0, 3] == -1.5
    assert not b[skin].any()


def test_with_boundary_assembles_nothing(scene):
    other = scene.with_boundary(4.0, 3.0)
    assert other.rows is scene.rows
    assert other.laplace is scene.laplace
    np.testing.assert_allclose(other.b, 2.0 * scene.b)


def test_the_defaults_and_the_papers_choices():
    scene = Scene.assemble(VOXMAP, SHELL, TRAJECTORY)
    assert scene.sampling == "trilinear"
    assert scene.inner == scene.parameters["boundary_scale"] != 1.0
    paper = Scene.assemble(VOXMAP, SHELL, TRAJECTORY, **tt.paper.SCENE)
    assert (paper.sampling, paper.inner, paper.outer) == ("voxel-mean", 1.0, 1.0)
    weights = {t.name: t.weight for t in tt.load_formulation("eq10", scene).terms}
    assert weights == {"laplace": 1.0, "force": 1e-2, "torque": 1e-2}


@pytest.mark.parametrize(
    ("inner", "word"),
    [("auto", "must be a number"), (float("nan"), "must be finite .* inner nan")],
)
def test_bad_inner(inner, word):
    refuses(InputError, word, Scene.assemble, VOXMAP, SHELL, TRAJECTORY, inner=inner)


def test_several_recordings_are_joined_first():
    with pytest.raises(InputError, match=r"got list: join .* Trajectory\.concatenate"):
        Scene.assemble(VOXMAP, SHELL, [TRAJECTORY, TRAJECTORY])


def test_poses_without_wrench_have_rows_but_no_measurements():
    bare = tt.Trajectory(TRAJECTORY.time, TRAJECTORY.position, TRAJECTORY.rotation)
    scene = Scene.assemble(VOXMAP, SHELL, bare)
    assert scene.N.nnz > 0
    refuses(InputError, "fx, fy, fz", lambda: scene.f)


@pytest.mark.slow
def test_a_plan_goes_from_scan_to_scene_step_by_step():
    """From a cloud, from its surface and by hand: the same scene."""
    theta, z = np.meshgrid(
        np.linspace(0, 2 * np.pi, 200), np.linspace(0.0, 0.2, 100), indexing="ij"
    )
    r = SURFACE.radius_at(theta, z)
    cloud = np.stack([r * np.cos(theta), r * np.sin(theta), z], axis=-1).reshape(-1, 3)
    plan = ScenePlan(
        (9, 20, 10), 0.04, 0.16, inner=3.0, outer=2.0, sampling="trilinear"
    )
    halves = [TRAJECTORY.select(slice(0, 5)), TRAJECTORY.select(slice(5, None))]
    frame = tt.Axis(np.zeros(3), np.eye(3), support=None)  # no plane to look for
    found = plan.build(cloud, SHELL, halves, axis=frame)
    surface = tt.extract_surface(cloud, axis=frame)
    voxmap = tt.Voxmap.from_surface(
        surface, shape=(9, 20, 10), r_inner=0.04, r_outer=0.16
    )
    whole = tt.Trajectory.concatenate(halves)
    expected = Scene.assemble(
        voxmap, SHELL, whole, inner=3.0, outer=2.0, sampling="trilinear"
    )
    for scene in (found, plan.build(surface, SHELL, whole)):
        assert scene.voxmap.grid == expected.voxmap.grid
        assert scene.sampling == expected.sampling
        assert (scene.inner, scene.outer) == (3.0, 2.0)
        np.testing.assert_array_equal(scene.b, expected.b)
        np.testing.assert_array_equal(scene.N.toarray(), expected.N.toarray())


def test_the_picture_has_the_outline_in_the_plane(scene, monkeypatch):
    drawn: list[np.ndarray] = []
    monkeypatch.setattr(
        scene_module, "sections_svg", lambda outlines, *_: drawn.extend(outlines) or ""
    )
    scene._repr_html_()
    (outline,) = drawn
    surface = scene.voxmap.surface
    middle = surface.radius[:, len(surface.z) // 2]
    np.testing.assert_allclose(np.linalg.norm(outline, axis=1), middle)

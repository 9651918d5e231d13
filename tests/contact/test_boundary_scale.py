"""The boundary scale against brute force and the covariance of a linear fit."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import (
    InputError,
    MistakeWarning,
    TtusWarning,
    ellipsoid,
    presses,
    refuses,
    torso,
)
from ttus_opt.contact.boundary_scale import _report_scale
from ttus_opt.problem.terms.depth_map_estimate import estimate_depth_map

SURFACE = torso()
VOXMAP = tt.Voxmap.from_surface(SURFACE, shape=(9, 20, 10))
SHELL = ellipsoid()
TRAJECTORY = presses(SURFACE, 12, np.random.default_rng(0))


def test_the_scale_comes_with_its_standard_error():
    """Against the covariance of a linear fit by numpy, poses off the skin left out."""
    far = TRAJECTORY.position.copy()
    far[:2] *= [1.3, 1.3, 1.0]
    moved = replace(TRAJECTORY, position=far)
    scene = tt.Scene.assemble(VOXMAP, SHELL, moved, inner="fit", sampling="trilinear")
    unit = scene.with_boundary(1.0, 1.0)
    pressed = unit.N @ unit.laplace.solve(unit.b)
    touching = np.repeat(scene.rows.contact_points > 0, 3)
    (scale,), ((variance,),) = np.polyfit(
        np.ones(touching.sum()),
        scene.f[touching] / pressed[touching],
        0,
        w=np.abs(pressed[touching]),
        cov=True,
    )
    assert scene.parameters["boundary_scale"] == pytest.approx(scale, rel=1e-9)
    assert scene.standard_errors["boundary_scale"] == pytest.approx(
        np.sqrt(variance), rel=1e-6
    )
    assert not scene.with_boundary(1.0, 1.0).standard_errors


def test_a_scale_the_forces_do_not_bear_is_one_and_said():
    rng = np.random.default_rng(0)
    chance = 0.02 * TRAJECTORY.force + rng.normal(0.0, 3.0, TRAJECTORY.force.shape)
    noise = replace(TRAJECTORY, force=chance)
    with pytest.warns(
        TtusWarning, match=r"cannot determine the boundary scale.*1 is used"
    ):
        scene = tt.Scene.assemble(VOXMAP, SHELL, noise, inner="fit", outer=0.5)
    assert (scene.inner, scene.outer) == (1.0, 0.5)
    assert scene.parameters == {"boundary_scale": 1.0}
    assert "±" in scene.not_identified["boundary_scale"]
    assert not scene.standard_errors
    solution = tt.fit(scene, "coulomb_global", force_weight=1e-4)
    assert solution.parameters["boundary_scale"] == 1.0  # it is not searched either
    assert "±" in solution.not_identified["boundary_scale"]


@pytest.mark.parametrize(("scale", "words"), [(-1.8, "give"), (-2.2, "push into")])
def test_forces_push_inwards_beyond_two_standard_errors(scale, words):
    with pytest.warns(TtusWarning, match=words) as told:
        assert words in _report_scale(scale, 1.0)
    advice = "ON the probe" if scale < -2.0 else "record more contact"
    assert advice in str(told[0].message)


def test_a_probe_that_never_touches_has_no_scale():
    apart = replace(TRAJECTORY, position=TRAJECTORY.position * [1.3, 1.3, 1.0])
    told = pytest.warns(TtusWarning, match="touches the patient in none of 12 poses")
    with told, pytest.raises(InputError, match="the probe never touches"):
        tt.Scene.assemble(VOXMAP, SHELL, apart, inner="fit")


def test_pulling_forces_are_refused_by_inner_fit():
    pulled = replace(TRAJECTORY, force=-1e-3 * TRAJECTORY.force)  # slightly, too
    with pytest.raises(InputError, match="force ON the probe"):
        tt.Scene.assemble(VOXMAP, SHELL, pulled, inner="fit")


def test_pulling_forces_are_a_warning_where_no_fit_was_asked_for():
    """So that the sanity report can tell what is wrong with them."""
    pulled = replace(TRAJECTORY, force=-TRAJECTORY.force)
    with pytest.warns(MistakeWarning, match="push into the patient"):
        scene = tt.Scene.assemble(VOXMAP, SHELL, pulled)
        again = scene.resampled("voxel-mean")
    for one in (scene, again):
        assert one.inner == 1.0
        assert "push into" in one.not_identified["boundary_scale"]


def test_presses_too_light_for_any_voxel_leave_the_scale_at_one():
    """Points in contact that pass no inner face of the surface layer sample nothing."""
    skin = SURFACE.radius_at(np.zeros(1), np.full(1, 0.1))[0]
    at = np.full((12, 3), [skin + 0.019, 0.0, 0.1])
    light = replace(TRAJECTORY, position=at, rotation=np.tile(np.eye(3), (12, 1, 1)))
    scene = tt.Scene.assemble(VOXMAP, SHELL, light, sampling="voxel-mean")
    assert scene.touching.all()
    assert not scene.N.nnz
    assert scene.inner == 1.0
    refuses(InputError, "too lightly", estimate_depth_map, scene)

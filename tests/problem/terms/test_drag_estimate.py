import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, dragged_scene, with_wrenches
from ttus_opt.problem.formulation import load
from ttus_opt.problem.terms.drag_estimate import (
    LEAST_GAIN,
    LENGTHS,
    DragEstimate,
    _presliding,
    alike_drag,
    estimate_drag,
)


@pytest.mark.parametrize("acts_at", ["contact", "reference", "points"])
def test_the_estimate_finds_what_was_put_in(acts_at):
    estimate = estimate_drag(dragged_scene(acts_at))
    assert estimate.acts_at == acts_at
    assert estimate.friction_coefficient == pytest.approx(0.3, rel=1e-6)
    assert estimate.boundary_scale == pytest.approx(1.0, rel=1e-6)
    assert estimate.misfit < 1e-6


def test_a_scene_is_estimated_once():
    scene = dragged_scene("contact")
    found = estimate_drag(scene)
    assert alike_drag(scene)[0] is found
    assert estimate_drag(scene, "contact") is not found
    assert estimate_drag(scene.with_boundary(1.5, 1.5)) is not found


def test_a_scale_that_is_off_is_told():
    scene = dragged_scene("contact")
    estimate = estimate_drag(scene.with_boundary(1.5, 1.5))
    assert estimate.boundary_scale == pytest.approx(2.0, rel=1e-6)
    assert estimate.friction_coefficient == pytest.approx(0.3, rel=1e-6)


def test_without_drag_there_is_none():
    estimate = estimate_drag(dragged_scene("contact", mu=0.0))
    assert estimate.friction_coefficient < 1e-9


def test_drag_that_would_push_is_judged_without_it():
    """A lag of the sensor pushes along the motion; no place gains by a negative μ."""
    scene = dragged_scene("contact", mu=-0.3)
    p = scene.laplace.solve(scene.b)
    pressed = np.concatenate([scene.N @ p, scene.W @ p / scene.torque_length])
    measured = np.concatenate([scene.f, scene.tau / scene.torque_length])
    scale = pressed @ measured / (pressed @ pressed)
    rest = measured - scale * pressed
    for place in ("points", "contact", "reference"):
        estimate = estimate_drag(scene, place)
        assert estimate.friction_coefficient == 0.0
        assert estimate.boundary_scale == pytest.approx(scale)
        assert estimate.misfit == pytest.approx(np.sqrt(np.mean(rest**2)))


def test_viscous_drag_is_of_the_patch_only():
    """Drag at every point is Coulomb's: viscous drag does not stand in for it."""
    scene = dragged_scene("contact")
    with pytest.raises(InputError, match="one of auto, contact, reference, got 'poin"):
        load("viscous_drag", scene, acts_at="points")
    assert load("viscous_drag", scene).terms


@pytest.mark.slow
def test_drag_hardly_moves_the_boundary_scale(shared):
    """`inner="fit"` needs no friction: drag is across the force it scales."""
    folder = shared / "phantom"
    surface = tt.Surface.load(folder / "surface.nc")
    voxmap = tt.Voxmap.from_surface(surface, shape=(24, 60, 30), r_inner=0.03)
    shell = tt.PointShell.ellipsoid(semi_axes=(0.030, 0.0125, 0.018), n_points=800)
    for name in ("press_fit", "sweep_fit"):
        trajectory = tt.read_trajectory(folder / f"{name}.csv")
        scene = tt.Scene.assemble(
            voxmap, shell, trajectory, inner="fit", sampling="trilinear"
        )
        estimate = estimate_drag(scene)
        assert estimate.boundary_scale == pytest.approx(1.0, abs=0.02)
        assert estimate.friction_coefficient == pytest.approx(0.25, rel=0.15)


def test_drag_is_shown_where_forces_need_it():
    """A gain of one by chance; that of recordings with drag grows with the places."""
    scene = dragged_scene("contact")
    found = estimate_drag(scene)
    assert found.is_shown and found.gain > 3.0 * LEAST_GAIN
    p = scene.laplace.solve(scene.b)
    noise = np.random.default_rng(1).normal(0.0, 0.05, scene.f.shape)
    without = estimate_drag(with_wrenches(scene, scene.N @ p + noise, scene.W @ p))
    assert not without.is_shown and without.gain < 2.0


@pytest.mark.parametrize(("faded", "index"), [(9.0, 1), (5.0, None)])
def test_the_longest_of_short_bristles_needs_drag_that_sliding_shows(faded, index):
    """Else a probe on tissue that shears, such as a liver, would have friction."""
    drag = tt.terms.GlobalCoulomb(dragged_scene("contact"), "contact")
    gains = (30.0, 29.0, 20.0, 10.0, 9.0, 8.0, 7.0, 6.0)
    held = [
        DragEstimate(0.3, 1.0, "contact", 0.1, drag.with_presliding(length), gain)
        for length, gain in zip(LENGTHS, gains, strict=True)
    ]
    (found,) = _presliding(
        [DragEstimate(0.2, 1.0, "contact", 0.2, drag, faded)], [held]
    )
    assert found.drag.presliding == (0.0 if index is None else LENGTHS[index])
    assert found.drag.no_presliding == "any length below 0.2 mm is as likely"

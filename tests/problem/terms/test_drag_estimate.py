from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, dragged_scene, with_wrenches
from ttus_opt import example
from ttus_opt.contact.scene import Scene, ScenePlan
from ttus_opt.problem.formulation import load
from ttus_opt.problem.terms import drag_estimate
from ttus_opt.problem.terms.depth_map_estimate import estimate_depth_map
from ttus_opt.problem.terms.depth_profile import voxel_depths
from ttus_opt.problem.terms.drag_estimate import (
    LEAST_GAIN,
    LENGTHS,
    DragEstimate,
    _presliding,
    alike_drag,
    estimate_drag,
    estimate_dragged,
    estimate_shown,
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


MU = 0.3


def of_depth(acts_at, mu=MU):
    """Forces and torques of p = 60 d² with drag, which no Laplace field explains."""
    scene = dragged_scene(acts_at)
    p = 6e3 * np.maximum(voxel_depths(scene.voxmap), 0.0) ** 2
    drag = tt.terms.GlobalCoulomb(scene, acts_at, coefficient=mu).rows
    rng = np.random.default_rng(0)
    force = (scene.N - mu * drag.force) @ p
    force += rng.normal(0.0, 0.01, len(force))
    torque = (scene.W - mu * drag.torque) @ p
    measured = replace(
        scene.trajectory, force=force.reshape(-1, 3), torque=torque.reshape(-1, 3)
    )
    return Scene.assemble(scene.voxmap, scene.shell, measured, sampling=scene.sampling)


@pytest.mark.parametrize("acts_at", ["contact", "reference", "points"])
def test_evidence_finds_where_drag_acts(acts_at, monkeypatch):
    """Among all, whatever the Laplace field says of them."""
    scene = of_depth(acts_at)
    monkeypatch.setattr(
        drag_estimate, "alike_drag", lambda *where: alike_drag(*where, alike=np.inf)
    )
    drag, found = estimate_dragged(scene)
    assert drag.acts_at == acts_at
    rows = scene.N - drag.friction_coefficient * drag.drag.rows.force
    assert found.log_evidence == estimate_depth_map(scene, rows).log_evidence


@pytest.mark.parametrize(("ahead", "acts_at"), [(1.0, "points"), (2.0, "contact")])
def test_drag_acts_at_every_point_where_evidence_hardly_differs(
    ahead, acts_at, monkeypatch
):
    """A sweep alone tells it from drag of the patch by less than 1 in three of three.

    Fitted so, presses err by 0.05 N on one torso, and by 0.15 N with the patch's.
    """
    scene = of_depth("points")
    both = [
        one for one in alike_drag(scene, alike=np.inf) if one.acts_at != "reference"
    ]
    evidence = iter([ahead * (one.acts_at == "contact") for one in both])
    monkeypatch.setattr(drag_estimate, "alike_drag", lambda *_: both)
    monkeypatch.setattr(
        drag_estimate,
        "estimate_depth_map",
        lambda *_: SimpleNamespace(log_evidence=next(evidence)),
    )
    assert estimate_dragged(scene)[0].acts_at == acts_at


def test_what_the_laplace_field_tells_apart_is_not_asked_again():
    scene = dragged_scene("contact")  # of a Laplace field, without noise
    (only,) = alike_drag(scene)
    assert only.acts_at == "contact"
    every = alike_drag(scene, alike=np.inf)
    assert every[0].misfit == min(one.misfit for one in every) and len(every) > 1
    assert estimate_dragged(scene, "reference")[0].acts_at == "reference"
    with pytest.raises(InputError, match="acts_at must be one of auto"):
        estimate_dragged(scene, "handle")


def test_given_values_are_held():
    _, found = estimate_dragged(dragged_scene("contact"), depth_length=0.02)
    assert found.depth_length == 0.02


@pytest.mark.slow
def test_the_example_drags_where_its_sweep_does():
    """Drag of the whole patch; a Laplace field takes it for that of every point."""
    surface = tt.Surface.load(example.path("surface.nc"))
    plan = ScenePlan((16, 48, 20), sampling="contact-size")
    names = "press_fit.csv", "sweep_drag_fit.csv"
    recordings = [tt.read_trajectory(example.path(name)) for name in names]
    shell = tt.PointShell.from_spec(example.PROBE)
    scene = plan.build(surface, shell, recordings)
    assert [one.acts_at for one in alike_drag(scene)] == ["points", "contact"]
    assert estimate_dragged(scene)[0].acts_at == "contact"


def test_the_depth_map_shows_drag_of_too_few_places_for_the_laplace_field(monkeypatch):
    """Presses alone of a soft torso: 0.15 N of error at new places without it."""
    monkeypatch.setattr(drag_estimate, "LEAST_GAIN", np.inf)
    without = of_depth("reference", mu=0.0)
    drag, found = estimate_shown(of_depth("reference"))
    assert drag.acts_at == "reference" and not drag.is_shown
    assert drag.friction_coefficient == pytest.approx(MU, rel=0.1)
    assert found.profile.exponents[0] == pytest.approx(2.0, rel=0.05)
    calls = []
    estimate = drag_estimate.estimate_depth_map

    def counted(*given, **options):
        calls.append(given)
        return estimate(*given, **options)

    monkeypatch.setattr(drag_estimate, "estimate_depth_map", counted)
    assert estimate_shown(without)[0] is None and len(calls) == 1  # not even suspected
    monkeypatch.setattr(drag_estimate, "SUSPECTED", -1.0)
    assert estimate_shown(without)[0] is None and len(calls) > 2

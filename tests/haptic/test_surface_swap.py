"""A patient whose surface changes: no jump, no energy beyond the reserve."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from ttus_opt.haptic.surface_swap import PatientRenderer

SHELL = tt.PointShell.from_spec("sphere:0.02", n_points=400)
DOWN = np.diag([1.0, -1.0, -1.0])


def field(radius=0.10, stiffness=4.0):
    """Potential proportional to depth below a cylinder."""
    z = np.linspace(0.0, 0.3, 31)
    surface = tt.Surface.from_radius(np.full((60, 31), radius), z)
    voxmap = tt.Voxmap.from_surface(
        surface, shape=(16, 36, 16), r_inner=0.03, r_outer=0.13
    )
    depth = radius - np.broadcast_to(voxmap.grid.r[:, None, None], voxmap.grid.shape)
    return tt.PotentialField(voxmap, stiffness * depth / 0.01, "trilinear")


def pose(depth, radius=0.10):
    return np.eye(3), np.array([radius + 0.02 - depth, 0.0, 0.15])


def run(renderer, depths, start=0):
    forces = []
    for k, depth in enumerate(depths, start):
        forces.append(renderer.render(*pose(depth), time=1e-3 * k).force)
    return np.array(forces)


@pytest.mark.parametrize("shift", [0.005, -0.005])
def test_a_surface_is_swapped_within_the_force_rate(shift):
    law = tt.BlendLaw(force_rate=10.0, reserve=0.5)
    renderer = PatientRenderer(field(), SHELL, blend=law)
    before = run(renderer, np.full(3, 0.01))[-1]
    renderer.update(field(0.10 + shift))
    after = run(renderer, np.full(3000, 0.01), 3)
    steps = np.linalg.norm(np.diff(np.vstack([before, after]), axis=0), axis=1)
    assert steps.max() <= 10.0 * 1e-3 + 1e-9
    assert renderer.blend.progress == 1.0
    alone = tt.Renderer(field(0.10 + shift), SHELL).render(*pose(0.01)).force
    np.testing.assert_allclose(after[-1], alone, atol=1e-9)


def test_a_higher_surface_waits_for_the_tank_and_lifting_completes_it():
    renderer = PatientRenderer(field(), SHELL, blend=tt.BlendLaw(reserve=0.0))
    run(renderer, np.full(3, 0.01))
    renderer.update(field(0.105))
    run(renderer, np.full(500, 0.01), 3)
    assert renderer.blend.progress == 0.0
    run(renderer, np.full(2, -0.02), 503)
    assert renderer.blend.progress == 1.0


def test_work_on_the_hand_is_the_stored_energy_and_at_most_the_reserve():
    reserve = 0.004
    renderer = PatientRenderer(
        field(), SHELL, blend=tt.BlendLaw(force_rate=50.0, reserve=reserve)
    )
    t = np.arange(4000) * 1e-3
    depths = -0.004 + 0.014 * np.sin(np.pi * t / 2.0) ** 2
    work, last, new = 0.0, None, field(0.104, 6.0)
    for k, depth in enumerate(depths):
        if k == 500:
            renderer.update(new)
        R, at = pose(depth)
        force = renderer.render(R, at, time=1e-3 * k).force
        if last is not None:
            work += 0.5 * float((force + last[0]) @ (at - last[1]))
        last = force, at
    assert renderer.blend.injected <= reserve + 1e-9
    assert work <= reserve + 2e-4  # quadrature of the shell
    assert renderer.blend.progress == 1.0  # it was lifted


@pytest.mark.parametrize(
    ("before", "updates", "frames"),
    [
        (3, [field(0.101), field(0.102), field(0.103)], 1500),  # the last one counts
        (3, [replace(field(), values=0.5 * field().values)], 1500),  # of one surface
        (0, [field(0.105)], 1),  # before the first frame it is used at once
    ],
)
def test_what_an_update_ends_at(before, updates, frames):
    law = tt.BlendLaw(force_rate=100.0, reserve=10.0)
    renderer = PatientRenderer(field(), SHELL, blend=law)
    run(renderer, np.full(before, 0.01))
    for update in updates:
        renderer.update(update)
    last = run(renderer, np.full(frames, 0.01), before)[-1]
    alone = tt.Renderer(updates[-1], SHELL).render(*pose(0.01)).force
    np.testing.assert_allclose(last, alone, atol=1e-9)


def test_a_reserve_per_contact_is_refilled_when_lifted():
    law = tt.BlendLaw(force_rate=50.0, reserve=0.02, per_contact=True)
    renderer = tt.Renderer(field(), SHELL, blend=law)
    for turn in range(3):
        for k, depth in enumerate([-0.02, 0.01, *np.full(2000, 0.01)]):
            if k == 2:
                renderer.update(field(stiffness=4.0 + 0.2 * (turn + 1)))
            renderer.render(*pose(depth))
        assert renderer.blend.progress == 1.0
    assert renderer.blend.injected > 0.0
    renderer.render(*pose(-0.02))
    assert renderer.blend.tank == pytest.approx(0.02)

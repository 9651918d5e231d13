"""Drags swapped with their fields: rate, energy, and an update amid a swap."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.haptic.test_blend import Walk, field_of, shell, twist


def dragging(stiffness, friction, **other):
    parameters = {"friction_coefficient": friction, **other}
    return replace(field_of(stiffness), parameters=parameters)


def full_twist(walk, k, seconds=1e-3):
    """Of the probe frame's origin from frame k − 1 to k."""
    turn = Rotation.from_matrix(walk.rotation[k] @ walk.rotation[k - 1].T).as_rotvec()
    moved = walk.position[k] - walk.position[k - 1]
    return np.concatenate([moved, turn]) / seconds


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 1])
def test_drags_are_swapped_with_their_fields(seed):
    """A convex combination of whole wrenches, within the rate, that takes energy."""
    law = tt.BlendLaw(force_rate=20.0, reserve=1e-4)
    walk = Walk.make(seed)
    along = twist(walk)
    old = dragging(1.0, 0.4)
    new = dragging(1.6, 0.1, viscous_coefficient=5.0, drag_deadband=0.01)
    renderer = tt.Renderer(old, shell(), blend=law)
    whole = [tt.Renderer(f, shell()) for f in (old, new)]
    bare = [tt.Renderer(replace(f, parameters={}), shell()) for f in (old, new)]
    out, both, contact = np.zeros(6), np.zeros((2, 6)), np.zeros((2, 6))
    moved, share, taken = 0, 0.0, 0.0
    for k in range(1, 900):
        pose, twist_here = (walk.rotation[k], walk.position[k]), full_twist(walk, k)
        if k == 260:
            renderer.update(new)
            share = 0.0
        renderer.render_into(*pose, out, twist_here)
        if k < 260:
            continue
        for i in (0, 1):
            whole[i].render_into(*pose, both[i], twist_here)
            bare[i].render_into(*pose, contact[i])
        state = renderer.blend
        weights = np.array([1 - state.progress, state.progress])
        np.testing.assert_allclose(out, weights @ both, atol=1e-12)
        jump = (state.progress - share) * (both[1] - both[0])
        limit = law.force_rate * law.frame_seconds * (1 + 1e-9)
        assert np.linalg.norm(jump[:3]) <= limit
        assert np.linalg.norm(jump[3:]) <= limit * shell().rms_radius
        assert state.injected <= law.reserve + 1e-15
        power = (out - weights @ contact) @ along[k]
        assert power <= 1e-15
        taken -= power
        moved += 0.0 < state.progress < 1.0
        share = state.progress
    assert moved > 20
    assert taken > 1e-3  # joules, in half a second of strokes


def test_energy_is_reckoned_without_drag():
    """Ledgers of a swap with and without drag are the same but for the rates' steps."""
    walk, law = Walk.make(4), tt.BlendLaw(force_rate=1e6)
    dry = tt.Renderer(field_of(1.0), shell(), blend=law)
    rubbed = tt.Renderer(dragging(1.0, 0.5), shell(), blend=law)
    for k in range(1, 700):
        pose, moving = (walk.rotation[k], walk.position[k]), full_twist(walk, k)
        dry.render(*pose, moving)
        rubbed.render(*pose, moving)
        if k == 300:
            dry.update(field_of(1.8))
            rubbed.update(dragging(1.8, 0.05))
        assert dry.blend == rubbed.blend


@pytest.mark.parametrize(
    "other", [{}, {"viscous_coefficient": 3.0}, {"drag_at_points": 1.0}]
)
def test_an_update_amid_a_swap_of_drags_does_not_show(other):
    R, at = np.eye(3), np.array([0.0, 0.093, 0.1])
    moving = np.array([0.03, 0.0, 0.02, 0.1, 0.3, -0.2])
    law = tt.BlendLaw(force_rate=1.0, reserve=1.0)
    alike = {k: v for k, v in other.items() if k == "drag_at_points"}
    renderer = tt.Renderer(dragging(1.0, 0.3, **alike), shell(), blend=law)
    before = renderer.render(R, at, moving).force
    for stiffness, friction in ((1.5, 0.05), (0.2, 0.8), (3.0, 0.0), (1.0, 0.6)):
        renderer.update(dragging(stiffness, friction, **other))
        for _ in range(7):
            after = renderer.render(R, at, moving).force
            assert np.linalg.norm(after - before) <= 1e-3 * (1 + 1e-6)
            before = after
        assert 0.0 < renderer.blend.progress < 1.0

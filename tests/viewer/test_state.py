"""The viewer's state against the renderer, and motion without jumps."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import InputError, refuses, torso
from tests.viewer.conftest import field, probe, recorded
from ttus_opt.contact.standing import depth_of, places_below, skin_points
from ttus_opt.viewer.state import LEAST, MOST, ViewState

FRAME = 1.0 / 60.0  # [s]


def settle(state):
    """Let the probe arrive; the frames that it took."""
    for frame in range(2000):
        if not state.advance(FRAME):
            return frame
    raise AssertionError("the probe did not come to rest")


def expected(state, which=0):
    """What a renderer of its own gives where the hand is."""
    wrench = tt.Renderer(state.fields[which], probe()).render(*state.pose)
    return np.concatenate([wrench.force, wrench.torque])


def felt(state, which=0):
    wrench = state.touches[which].wrench
    return np.concatenate([wrench.force, wrench.torque])


def test_the_probe_stands_on_the_skin_before_anything_is_done(state):
    assert state.depth == pytest.approx(0.005, abs=1e-6)
    assert np.linalg.norm(felt(state)) > 0.1
    np.testing.assert_allclose(felt(state), expected(state), atol=1e-12)
    np.testing.assert_allclose(state.angles, 0.0, atol=1e-6)


@pytest.mark.parametrize("act", ["slide", "press", "move", "tilt", "put"])
def test_what_is_felt_at_rest_is_what_the_renderer_gives(state, act):
    before = felt(state)
    R = Rotation.from_rotvec([0.1, 0.0, 0.2]).as_matrix() @ state.pose[0]
    {
        "slide": lambda: state.slide(2.2, 0.12),
        "press": lambda: state.press(0.011),
        "move": lambda: state.move(around=0.01, along=-0.02, deeper=0.002),
        "tilt": lambda: state.tilt(np.array([10.0, -5.0, 8.0])),
        "put": lambda: state.put(R, state.pose[1] + [0.0, -0.002, 0.004]),
    }[act]()
    np.testing.assert_array_equal(felt(state), before)  # nothing jumps
    settle(state)
    np.testing.assert_allclose(felt(state), expected(state), atol=1e-12)
    assert np.abs(felt(state) - before).max() > 1e-3
    rotation, position = state.pose
    reference = position + rotation @ probe().reference
    below = places_below(torso(), reference[None])
    np.testing.assert_allclose(np.ravel(below), state.place, atol=2e-3)


def test_a_place_a_depth_and_angles_are_reached(state):
    state.slide(2.0, 0.11)
    state.press(0.008)
    state.tilt(np.array([20.0, -10.0, 5.0]))
    assert state.depth == pytest.approx(0.008, abs=1e-6)
    np.testing.assert_allclose(state.place, (2.0, 0.11), atol=2e-3)
    np.testing.assert_allclose(state.angles, [20.0, -10.0, 5.0], atol=1.0)
    state.slide(1.0, 0.09)  # keeps both
    assert state.depth == pytest.approx(0.008, abs=1e-6)
    np.testing.assert_allclose(state.angles, [20.0, -10.0, 5.0], atol=1.0)


def test_a_place_is_told_within_half_a_turn(state):
    for theta in (4.0, -4.0, 7.0):
        state.slide(theta, 0.1)
        turns = (theta - state.place[0]) / (2.0 * np.pi)
        assert turns == pytest.approx(round(turns), abs=1e-9)
        assert abs(state.place[0]) <= np.pi


def test_a_millimetre_is_a_millimetre(state):
    place = state.pose[1].copy()
    state.move(along=0.001)
    assert state.pose[1][2] - place[2] == pytest.approx(0.001, abs=1e-4)
    first = state.place
    for _ in range(10):
        state.move(around=0.001)
    theta, z = np.array([first[0], state.place[0]]), np.array([first[1]] * 2)
    way = np.linalg.norm(np.diff(skin_points(torso(), theta, z), axis=0))
    assert way == pytest.approx(0.01, rel=0.05)
    state.move(deeper=0.001)
    assert state.depth == pytest.approx(0.006, abs=1e-6)


def test_the_force_does_not_step_while_drags_come_20_times_a_second(state):
    theta, z = state.place
    forces = [np.linalg.norm(felt(state)[:3])]
    raw = []
    for drag in range(10):  # 10 cm/s
        state.slide(theta + 0.005 * (drag + 1) / 0.09, z)
        state.press(0.005 + 0.0006 * (drag + 1))
        raw.append(np.linalg.norm(expected(state)[:3]))
        for _ in range(3):
            assert state.advance(FRAME)
            forces.append(np.linalg.norm(felt(state)[:3]))
    steps, raw_steps = np.abs(np.diff(forces)).max(), np.abs(np.diff(raw)).max()
    assert steps < 0.5 * raw_steps


def test_depths_stay_within_reason(state):
    state.move(deeper=1.0)
    assert state.depth == pytest.approx(MOST, abs=1e-6)
    state.move(deeper=-1.0)
    assert state.depth == pytest.approx(LEAST, abs=1e-6)
    settle(state)
    assert not felt(state).any()
    assert state.touches[0].contact_length == 0.0


def test_a_recorded_frame_is_felt_as_the_recording_is_rendered(state):
    for frame in (0, 5, 11):
        state.show_frame(frame)
        np.testing.assert_array_equal(state.pose[1], recorded().position[frame])
        np.testing.assert_array_equal(
            felt(state)[:3], state.recording.rendered[0][frame]
        )
        np.testing.assert_array_equal(state.measured, recorded().force[frame])
    assert not state.advance(FRAME)  # nothing moves by itself
    state.press(0.004)  # and a hand takes over
    settle(state)
    assert state.measured is None
    np.testing.assert_allclose(felt(state), expected(state), atol=1e-12)


def test_two_fields_are_felt_with_one_probe():
    both = ViewState([field(), field(2.0)], probe())
    both.press(0.008)
    settle(both)
    np.testing.assert_allclose(felt(both, 1), 2.0 * felt(both, 0), rtol=1e-9)
    np.testing.assert_allclose(felt(both, 1), expected(both, 1), atol=1e-12)


def test_poses_from_outside_are_felt_at_once(state):
    R, x = recorded().rotation[3], recorded().position[3]
    state.follow(R, x, measured=np.array([0.0, 1.0, 0.0]))
    assert state.source == "outside"
    np.testing.assert_allclose(felt(state), expected(state), atol=1e-12)
    np.testing.assert_array_equal(state.measured, [0.0, 1.0, 0.0])
    state.follow(R, x, time=1.0)
    state.follow(R, np.add(x, [0.0, 0.001, 0.0]), time=1.1)
    refuses(InputError, "not go back", state.follow, R, x, time=0.5)


def test_a_new_field_is_felt_without_a_new_page(state):
    force = np.linalg.norm(felt(state)[:3])
    state.update(field(1.5))
    assert state.advance(FRAME)
    assert np.linalg.norm(felt(state)[:3]) == pytest.approx(1.5 * force, rel=1e-6)


def test_a_touch_beyond_the_model_says_so():
    voxmap = tt.Voxmap.from_surface(
        torso(), shape=(24, 24, 20), r_inner=0.03, sector=(0.5, 2.6)
    )
    depth = voxmap.spoke_radius[None] - voxmap.grid.r[:, None, None]
    values = np.where(voxmap.region == 0, 0.0, 200.0 * depth)
    part = ViewState([tt.PotentialField(voxmap, values, "trilinear")], probe())
    settle(part)
    assert part.touches[0].notes == ()
    part.slide(4.5, 0.1)
    settle(part)
    assert not felt(part).any()
    assert part.touches[0].notes == ("beyond the model: nothing pushes back here",)
    part.slide(0.5, 0.1)
    settle(part)
    assert "part of the contact" in part.touches[0].notes[0]


def test_what_limits_a_force_is_said():
    strong = ViewState([field(20.0)], probe())
    strong.press(0.03)
    settle(strong)
    assert strong.touches[0].wrench.saturated
    assert any("renderer's limit of 40 N" in note for note in strong.touches[0].notes)
    ends = ViewState([field()], probe())
    ends.slide(1.5, 0.2)
    settle(ends)
    assert any("end of the model" in note for note in ends.touches[0].notes)


def test_without_a_probe_there_is_nothing_to_move():
    still = ViewState([field()], None, recorded())
    assert not still.advance(FRAME)
    assert still.touches == ()
    refuses(InputError, "no probe", still.press, 0.01)
    refuses(InputError, "no recording", still.show_frame, 0)


def test_fields_of_two_patients_are_refused():
    other = tt.Surface.from_radius(np.full((90, 31), 0.1), torso().z)
    voxmap = tt.Voxmap.from_surface(other, shape=(24, 48, 20), r_inner=0.03)
    round_one = tt.PotentialField(voxmap, np.zeros(voxmap.grid.shape), "trilinear")
    refuses(InputError, "differ by up to", ViewState, [field(), round_one], probe())
    refuses(InputError, "one field or two", ViewState, [], probe())


def test_depth_is_that_of_the_deepest_point(state):
    state.put(state.pose[0], state.pose[1] + [0.0, 0.01, 0.0])
    settle(state)
    R, x = state.pose
    one = depth_of(torso(), probe(), R[None], x[None])[0]
    assert state.touches[0].depth == one == state.depth

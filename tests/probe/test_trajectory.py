import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.kit import SHARED, InputError, presses, refuses, torso
from ttus_opt.probe.trajectory import Trajectory, read_trajectory, thinned

FILES = sorted([*SHARED.glob("phantom*/*.csv"), *SHARED.glob("wrench/*.csv")])


def made(n=21, *, wrench=True, rate=0.8, start=0.0):
    """A screw about z: both velocities are known."""
    time = start + 0.05 * np.arange(n)
    angle = rate * time
    position = np.stack([0.1 * np.cos(angle), 0.1 * np.sin(angle), 0.02 * time], axis=1)
    rotation = Rotation.from_rotvec(angle[:, None] * [0, 0, 1]).as_matrix()
    force, torque = np.full((n, 3), 2.0), np.full((n, 3), 0.1)
    return Trajectory(
        time, position, rotation, *((force, torque) if wrench else (None, None))
    )


def test_velocities_of_a_screw():
    screw = made()
    np.testing.assert_allclose(screw.angular_velocity(), [[0, 0, 0.8]] * 21, atol=1e-12)
    exact = np.cross([0, 0, 0.8], screw.position) + np.array([0, 0, 0.02])
    # central differences: h²/6 · |x'''| inside, h/2 · |x''| at the ends
    error = np.abs(screw.velocity() - exact)
    assert error[1:-1].max() < 0.05**2 / 6 * 0.1 * 0.8**3 * 1.01
    assert error.max() < 0.05 / 2 * 0.1 * 0.8**2 * 1.01


def test_velocity_with_uneven_steps_is_exact_for_a_parabola():
    time = np.array([0.0, 0.1, 0.15, 0.4, 0.45])
    position = np.stack([time**2, 3 * time, 0 * time], axis=1)
    moving = Trajectory(time, position, np.tile(np.eye(3), (5, 1, 1)))
    velocity = moving.velocity()
    np.testing.assert_allclose(velocity[1:-1, 0], 2 * time[1:-1], atol=1e-12)
    np.testing.assert_allclose(velocity[:, 1], 3, atol=1e-12)


def test_nothing_is_differenced_across_recordings():
    far = made(5, start=3.0)
    far = Trajectory(
        far.time - 3.0, far.position + 1.0, far.rotation, far.force, far.torque
    )
    both = Trajectory.concatenate([made(), far, far.select(slice(0, 1))])
    np.testing.assert_array_equal(both.segment, [0] * 21 + [1] * 5 + [2])
    np.testing.assert_array_equal(both.velocity()[:21], made().velocity())
    np.testing.assert_array_equal(both.velocity()[21:26], far.velocity())
    np.testing.assert_array_equal(both.velocity()[26], 0)
    np.testing.assert_array_equal(
        both.angular_velocity()[:21], made().angular_velocity()
    )
    np.testing.assert_array_equal(both.angular_velocity()[26], 0)
    twice = Trajectory.concatenate([both, both])
    np.testing.assert_array_equal(np.unique(twice.segment), np.arange(6))


def test_select():
    whole = made()
    some = whole.select(whole.time > 0.5)
    np.testing.assert_array_equal(some.time, whole.time[whole.time > 0.5])
    assert some.has_wrench and len(whole.select(slice(None, None, 4))) == 6
    assert not made(wrench=False).select(np.array([0, 3])).has_wrench
    refuses(InputError, "no frame", whole.select, whole.time > 99)
    refuses(InputError, r"shape \(21,\)", whole.select, np.array([True, False]))


def test_recordings_are_told_apart_in_their_order():
    first, second = made(5), made(8, start=3.0)
    joined = Trajectory.concatenate([first, second])
    turned = joined.select(np.r_[5:13, 0:5])  # the second one's number is larger
    assert turned.parts == [slice(0, 8), slice(8, 13)]
    for own, source in zip(turned.recordings, (second, first), strict=True):
        np.testing.assert_array_equal(own.time, source.time)
        np.testing.assert_array_equal(own.force, source.force)


def test_concatenate_refuses():
    refuses(InputError, "at least one", Trajectory.concatenate, [])
    with pytest.raises(InputError, match="of 2 trajectories number 2 have no wrenches"):
        Trajectory.concatenate([made(), made(wrench=False)])


@settings(max_examples=25)
@given(
    seed=st.integers(0, 2**32 - 1),
    n=st.integers(1, 12),
    wrench=st.booleans(),
    n_segments=st.integers(1, 3),
)
def test_saving_and_reading_gives_it_back(
    tmp_path_factory, seed, n, wrench, n_segments
):
    rng = np.random.default_rng(seed)

    def part():
        return Trajectory(
            np.cumsum(rng.uniform(1e-6, 1, n)),
            rng.normal(size=(n, 3)),
            Rotation.random(n, rng=rng).as_matrix(),
            100 * rng.normal(size=(n, 3)) if wrench else None,
            rng.normal(size=(n, 3)) if wrench else None,
        )

    before = Trajectory.concatenate([part() for _ in range(n_segments)])
    file = tmp_path_factory.mktemp("saved") / "new" / "t.csv"
    before.save(file)
    after = read_trajectory(file)
    for name in ("time", "position", "force", "torque", "segment"):
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    np.testing.assert_allclose(after.rotation, before.rotation, atol=1e-14)
    assert after.has_wrench == wrench
    assert [f.name for f in file.parent.iterdir()] == ["t.csv"]


@pytest.mark.skipif(not FILES, reason="shared recordings are not here")
@pytest.mark.parametrize("file", FILES, ids=lambda f: f"{f.parent.name}-{f.stem}")
def test_real_files(file):
    trajectory = read_trajectory(file)
    raw = np.genfromtxt(file, delimiter=",", names=True)
    assert len(trajectory) == len(raw) and trajectory.has_wrench
    np.testing.assert_array_equal(trajectory.position[:, 1], raw["py"])
    np.testing.assert_array_equal(trajectory.torque[:, 2], raw["tz"])
    # third column of the rotation from the quaternion's own formula
    w, x, y, z = (raw[f"q{c}"] for c in "wxyz")
    third = [2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z]
    third = np.stack(third, axis=1) / (w * w + x * x + y * y + z * z)[:, None]
    np.testing.assert_allclose(trajectory.rotation[:, :, 2], third, atol=1e-12)
    assert np.abs(trajectory.velocity()).max() < 1.5  # from one place to the next


EYE = np.tile(np.eye(3), (3, 1, 1))


@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"time": np.zeros(0)}, "at least one frame"),
        ({"time": np.array([0.0, 0.1, 0.1])}, "increase .* 0.1 then 0.1 at frame 2"),
        ({"position": np.zeros((2, 3))}, r"position must have shape \(3, 3\)"),
        ({"position": np.full((3, 3), np.nan)}, "nan in frame 0: not fin.* in 3 of 3"),
        ({"time": np.array([0.0, 1.0, np.inf])}, "inf in frame 2: .* in 1 of 3"),
        *(
            ({"force": EYE[0], name: -1e160 * EYE[0]}, f"{name} is 1e.160 .*ible unit")
            for name in ("position", "force", "torque")
        ),
        ({"rotation": 2 * EYE}, "frame 0: not a rotation"),
        ({"rotation": -EYE}, "not a rotation"),
        ({"torque": np.zeros((3, 3))}, "only torque"),
        ({"segment": np.array([0, 1, 0])}, "be contiguous"),
        ({"segment": np.array([0, 1])}, "segment must have shape"),
    ],
)
def test_a_trajectory_is_validated(change, text):
    parts = {"time": np.arange(3.0), "position": np.zeros((3, 3)), "rotation": EYE}
    refuses(InputError, text, Trajectory, **{**parts, **change})


def test_from_arrays_takes_every_form():
    rng = np.random.default_rng(9)
    turns = Rotation.random(5, rng=rng)
    positions = rng.uniform(-1, 1, (5, 3))
    times = np.arange(5) * 0.1
    whole = np.tile(np.eye(4), (5, 1, 1))
    whole[:, :3, :3], whole[:, :3, 3] = turns.as_matrix(), positions
    forms = [
        Trajectory.from_arrays(positions, turns, times=times),
        Trajectory.from_arrays(positions, turns.as_matrix(), times=times),
        Trajectory.from_arrays(positions, turns.as_quat(), times=times, order="xyzw"),
        Trajectory.from_arrays(
            positions,
            turns.as_quat(scalar_first=True).tolist(),
            times=times,
            order="wxyz",
        ),
        Trajectory.from_arrays(None, whole, times=times),
    ]
    for found in forms:
        np.testing.assert_allclose(found.rotation, turns.as_matrix(), atol=1e-12)
        np.testing.assert_array_equal(found.position, positions)
        np.testing.assert_array_equal(found.time, times)
        assert not found.has_wrench
    force = rng.standard_normal((5, 3))
    found = Trajectory.from_arrays(positions, turns, force)
    assert found.has_wrench
    assert not found.has_torque
    assert found.time.tolist() == [0, 1, 2, 3, 4]
    force[0] = 7.0  # the caller's array is the caller's
    assert found.force[0, 0] != 7.0


@pytest.mark.parametrize(
    ("positions", "orientations", "order", "text"),
    [
        (np.zeros((2, 3)), np.tile([0, 0, 0, 1.0], (2, 1)), None, "needs order="),
        (np.zeros((2, 3)), np.tile([0, 0, 0, 2.0], (2, 1)), "xyzw", "length 2"),
        (np.zeros((2, 3)), np.tile(np.eye(3), (2, 1, 1)), "xyzw", "of quaternions"),
        (np.zeros((2, 3)), np.tile(np.eye(4), (2, 1, 1)), None, r"\(2, 4, 4\) and"),
        (None, np.tile(np.eye(3), (2, 1, 1)), None, "no positions"),
        (np.zeros((3, 3)), np.tile(np.eye(3), (2, 1, 1)), None, r"positions \(3, 3\)"),
        (None, np.ones((2, 4, 4)), None, "ends in the row"),
    ],
)
def test_from_arrays_refuses(positions, orientations, order, text):
    with pytest.raises(InputError, match=text):
        Trajectory.from_arrays(positions, orientations, order=order)


def test_a_motion_carries_points_and_forces_of_the_probe():
    """A point of the probe and a force on it land where the motions put them."""
    rng = np.random.default_rng(2)
    own = Trajectory.from_arrays(
        rng.uniform(-1, 1, (4, 3)),
        Rotation.random(4, rng=rng),
        rng.standard_normal((4, 3)),
        rng.standard_normal((4, 3)),
    )
    first, second = np.eye(4), np.eye(4)
    for matrix in (first, second):
        matrix[:3, :3] = Rotation.random(rng=rng).as_matrix()
        matrix[:3, 3] = rng.uniform(-1, 1, 3)
    moved = own.transformed(first, second)
    tip = np.array([0.01, 0.02, 0.1])
    for t in range(4):
        before = own.rotation[t] @ tip + own.position[t]
        after = moved.rotation[t] @ tip + moved.position[t]
        expected = second @ first @ np.append(before, 1.0)
        np.testing.assert_allclose(after, expected[:3], atol=1e-12)
        # power of force and torque does not depend on the frame
        arm, turned = rng.standard_normal((2, 3))
        power = own.force[t] @ arm + own.torque[t] @ turned
        turn = second[:3, :3] @ first[:3, :3]
        same = moved.force[t] @ (turn @ arm) + moved.torque[t] @ (turn @ turned)
        assert same == pytest.approx(power)
    assert own.transformed().position.tolist() == own.position.tolist()
    with pytest.raises(InputError, match="scales by 1000"):
        own.transformed(np.diag([1e3, 1e3, 1e3, 1.0]))


def test_forces_alone_are_written_read_and_joined(tmp_path):
    own = Trajectory.from_arrays(
        np.zeros((3, 3)), np.tile(np.eye(3), (3, 1, 1)), np.ones((3, 3))
    )
    assert repr(own).endswith("with forces)")
    own.save(tmp_path / "force.csv")
    again = read_trajectory(tmp_path / "force.csv")
    np.testing.assert_array_equal(again.force, own.force)
    assert again.torque is None
    assert own.select(slice(0, 2)).torque is None
    assert Trajectory.concatenate([own, again]).torque is None
    whole = Trajectory.from_arrays(
        np.zeros((3, 3)),
        np.tile(np.eye(3), (3, 1, 1)),
        np.ones((3, 3)),
        np.ones((3, 3)),
    )
    refuses(InputError, "others only forces", Trajectory.concatenate, [own, whole])


# ------------------------------------------------------------ fewer frames

ONE = presses(torso(), 30, np.random.default_rng(0))  # every 0.05 s
TWO = Trajectory.concatenate([ONE, ONE.select(slice(1, None))])


def test_every_counts_in_each_recording():
    left = thinned(TWO, every=10)
    assert left.time.tolist() == pytest.approx([0, 0.5, 1.0, 0.05, 0.55, 1.05])
    assert left.segment.tolist() == [0, 0, 0, 1, 1, 1]
    np.testing.assert_array_equal(left.force, TWO.force[[0, 10, 20, 30, 40, 50]])


@pytest.mark.parametrize(
    ("rate", "expected"), [(4.0, 6), (20.0, 30), (1e4, 30), (7.0, 11), (0.1, 1)]
)
def test_rate_is_the_most_frames_a_second(rate, expected):
    assert len(thinned(ONE, rate=rate)) == expected


def test_both_together():
    assert thinned(ONE, rate=10.0, every=5).time.tolist() == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("every", [0, -1, 1.5])
def test_every_is_a_count(every):
    refuses(InputError, "every", thinned, ONE, every=every)


@pytest.mark.parametrize("rate", [0.0, -1.0, np.nan, np.inf])
def test_rate_is_positive(rate):
    refuses(InputError, "rate", thinned, ONE, rate=rate)

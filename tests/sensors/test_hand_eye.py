"""Hand-eye calibration: known answers, real pairs, and what OpenCV would not say."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, GeometryError, InputError, TtusWarning, refuses
from ttus_opt.probe.rigid_motion import homogeneous, inverse
from ttus_opt.sensors.hand_eye import HAND_EYE, ROBOT_WORLD, hand_eye, read_pose_pairs


def motion(turn, shift):
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    return out


X = motion([0.3, -1.0, 2.0], [0.1, -0.4, 0.9])
Z = motion([1.0, 0.2, -0.5], [0.02, 0.05, -0.08])


def pairs(camera, n=12, noise=0.0, turns=None):
    """Marker in camera and hand in base for a known X and Z [rad, m]."""
    rng = np.random.default_rng(3)
    turns = rng.normal(0, 0.5, (n, 3)) if turns is None else turns
    B = np.array([motion(turn, rng.normal(0, 0.2, 3)) for turn in turns])
    G = np.array([inverse(b) for b in B]) if camera == "fixed" else B
    A = np.array([inverse(X) @ inverse(g) @ Z for g in G])
    for pose in A:
        pose[:3, 3] += rng.normal(0, noise, 3)
        pose[:3, :3] = motion(rng.normal(0, noise, 3), [0, 0, 0])[:3, :3] @ pose[:3, :3]
    return A, B


@pytest.mark.parametrize("camera", ["fixed", "moving"])
def test_every_solver_finds_a_known_answer(camera):
    found = hand_eye(*pairs(camera), camera)
    assert {*found.candidates} == {name.lower() for name in HAND_EYE + ROBOT_WORLD}
    for candidate in found.candidates.values():
        np.testing.assert_allclose(candidate.camera, X, atol=1e-6)
        np.testing.assert_allclose(candidate.marker, Z, atol=1e-6)
    assert found.loop.gap < 1e-6
    assert found.spread < 1e-6


def test_noise_shows_in_the_loop():
    found = hand_eye(*pairs("fixed", 40, noise=0.002), "fixed")
    np.testing.assert_allclose(found.camera, X, atol=0.005)
    assert 0.001 < found.loop.gap < 0.008
    assert found.loop.gap == min(one.loop.gap for one in found.candidates.values())
    assert found.loop.worst > found.loop.gap


@pytest.mark.parametrize("which", ["marker", "hand"])
def test_inverted_poses_are_noticed(which):
    A, B = pairs("moving")
    if which == "marker":
        A = np.array([inverse(pose) for pose in A])
    else:
        B = np.array([inverse(pose) for pose in B])
    with pytest.raises(InputError, match="expected are marker-to-camera") as told:
        hand_eye(A, B, "moving")
    assert "hand's poses inverted" in str(told.value)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize(
    "turns",
    [
        np.zeros((10, 3)),
        np.outer(np.linspace(-1, 1, 10), [0, 0, 1.0]),
        np.outer(np.linspace(-1, 1, 10), [1.0, 2.0, 0.5]),
        np.outer(np.linspace(-1, 1, 10), [0, 0, 1.0])
        + np.random.default_rng(0).normal(0, 0.01, (10, 3)),
    ],
)
def test_motions_that_do_not_determine_the_camera(turns):
    with pytest.raises(GeometryError, match="tilted about two axes"):
        hand_eye(*pairs("fixed", turns=turns), "fixed")


def test_loops_that_hardly_close():
    A, B = pairs("fixed", 20)
    A[:, :3, 3] *= 1.3  # a marker larger than was said
    refuses(InputError, "do not close", hand_eye, A, B, "fixed")
    with pytest.warns(TtusWarning, match="solvers' results differ"):
        hand_eye(*pairs("fixed", 5, noise=0.004), "fixed", largest_twist=1.0)


SEEN, HELD = pairs("fixed")


@pytest.mark.parametrize(
    ("A", "B", "options", "words"),
    [
        (np.eye(4)[None], np.eye(4)[None], {}, "at least 3 pairs"),
        (np.zeros((4, 3, 3)), np.zeros((4, 4, 4)), {}, r"\(n, 4, 4\)"),
        (np.zeros((4, 4, 4)), np.zeros((4, 4, 4)), {}, "pose 1"),
        (np.full((4, 4, 4), np.nan), np.zeros((4, 4, 4)), {}, "NaN"),
        (pairs("fixed", 4)[0], pairs("fixed", 5)[1], {}, "4 and 5"),
        (SEEN, HELD[::-1], {}, "same instants"),
        (homogeneous(SEEN[:, :3, :3], 1e3 * SEEN[:, :3, 3]), HELD, {}, "millimetres"),
        (SEEN, HELD, {"largest_gap": -1.0}, "must be above 0"),
        (SEEN, HELD, {"largest_twist": np.nan}, "must be above 0"),
        (SEEN, HELD, {"camera": "flying"}, "one of fixed, moving"),
    ],
)
def test_what_is_refused(A, B, options, words):
    refuses(InputError, words, hand_eye, A, B, **{"camera": "fixed", **options})


@pytest.mark.parametrize("suffix", ["json", "npy"])
def test_files_of_pairs(tmp_path, suffix):
    A, B = pairs("fixed")
    both = np.stack([A, B], axis=1)
    file = tmp_path / f"pairs.{suffix}"
    if suffix == "json":
        file.write_text(json.dumps(both.tolist()))
    else:
        np.save(file, both)
    a, b = read_pose_pairs(file)
    np.testing.assert_array_equal(a, A)
    np.testing.assert_array_equal(b, B)


@pytest.mark.parametrize("text", ["", "{}", "[1, 2]", "[[[1]]]", "no", "[" * 50_000])
def test_files_that_hold_none(tmp_path, text):
    (tmp_path / "pairs.json").write_text(text)
    refuses(FileError, "", read_pose_pairs, tmp_path / "pairs.json")

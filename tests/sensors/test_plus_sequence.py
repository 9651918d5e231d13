"""PLUS sequence files: transforms in mm, status, times."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, TtusWarning, refuses
from ttus_opt.sensors.stream_files import read_poses

HEAD = "ObjectType = Image\nNDims = 3\nDimSize = 2 2 6\nElementType = MET_UCHAR\n"


def sequence(file, names=("ProbeToTracker",), bad=3):
    """Six frames, one of them invalid, with pixels."""
    text = HEAD
    for i in range(6):
        turn = Rotation.from_rotvec([0, 0, 0.1 * i]).as_matrix()
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = turn, [10.0 * i, 20.0, -5.0]
        status = "INVALID" if i == bad else "OK"
        for name in names:
            field = f"Seq_Frame{i:04d}_{name}Transform"
            words = " ".join(f"{v:.6f}" for v in motion.ravel())
            text += f"{field} = {words}\n{field}Status = {status}\n"
        text += f"Seq_Frame{i:04d}_Timestamp = {100 + 0.05 * i:.3f}\n"
    file.write_bytes(text.encode() + b"ElementDataFile = LOCAL\n" + bytes(range(24)))
    return file


def test_a_sequence(tmp_path):
    found = read_poses(sequence(tmp_path / "s.mha"))
    np.testing.assert_allclose(found.time, 100 + 0.05 * np.array([0, 1, 2, 4, 5]))
    np.testing.assert_allclose(found.position[3], [0.040, 0.020, -0.005])
    turn = Rotation.from_matrix(found.rotation[4]).as_rotvec()
    np.testing.assert_allclose(turn, [0, 0, 0.5], atol=1e-5)
    assert found.segment.tolist() == [0, 0, 0, 1, 1]  # not bridged
    assert found.force is None


def test_several_transforms_are_named(tmp_path):
    names = ("ProbeToTracker", "ReferenceToTracker")
    file = sequence(tmp_path / "s.mha", names)
    refuses(FileError, "of poses: ProbeToTracker, ReferenceToT", read_poses, file)
    for word in ("ReferenceToTracker", "ReferenceToTrackerTransform"):
        assert len(read_poses(file, word)) == 5
    refuses(FileError, "no transform Stylus", read_poses, file, "Stylus")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("= OK", "= MISSING", "in view"),
        ("ProbeToTrackerTransform", "Image", "no transforms"),
        (
            "Seq_Frame0001_Timestamp",
            "Other",
            "no Timestamp, and the file no frame rate.*FrameRate = 20",
        ),
        ("= 1.000000", "= 1.0 2.0", "16 numbers"),
        ("= 1.000000", "= nan", "not finite"),
        ("= 1.000000", "= one", "one"),
        ("ObjectType = Image", "solid probe", "not a MetaImage"),
        ("Timestamp = 100.050", "Timestamp = 100.000", "repeats"),
    ],
)
def test_what_is_none(tmp_path, old, new, words):
    file = sequence(tmp_path / "s.mha")
    content = file.read_bytes().replace(old.encode(), new.encode())
    file.write_bytes(content)
    refuses(FileError, words, read_poses, file)


def test_frames_without_times(tmp_path):
    """By the times that older versions write, else by the file's rate, said."""
    text = sequence(tmp_path / "s.mha").read_bytes()
    expected = read_poses(tmp_path / "s.mha")
    for old, new, words, begin in (
        (b"_Timestamp", b"_UnfilteredTimestamp", "times are the Unfiltered", 100.0),
        (b"_Timestamp", b"_Other", "frame numbers at 20 Hz", 0.0),
    ):
        changed = text.replace(old, new)
        if not begin:
            changed = changed.replace(b"NDims", b"AcquisitionFrameRate = 20\nNDims")
        (tmp_path / "t.mha").write_bytes(changed)
        with pytest.warns(TtusWarning, match=words):
            found = read_poses(tmp_path / "t.mha")
        np.testing.assert_allclose(found.time, expected.time - 100.0 + begin)
        np.testing.assert_array_equal(found.position, expected.position)


def apart(file):
    """The text as a NRRD, or beside its pixels in a ``.raw``."""
    text = sequence(file).read_bytes().split(b"ElementDataFile")[0]
    if file.suffix == ".nrrd":
        text = b"NRRD0004\n" + text.replace(b" = ", b":=") + b"\n" + bytes(24)
    else:
        text += b"ElementDataFile = s.raw\n"
        file.with_name("s.raw").write_bytes(bytes(range(24)))
    file.write_bytes(text)
    return file


@pytest.mark.parametrize("suffix", [".igs.mha", ".mhd", ".nrrd"])
def test_other_headers_of_the_same_text(tmp_path, suffix):
    found = read_poses(apart(tmp_path / f"p{suffix}"))
    sequence(tmp_path / "s.mha")
    expected = read_poses(tmp_path / "s.mha")
    np.testing.assert_array_equal(found.position, expected.position)
    np.testing.assert_array_equal(found.rotation, expected.rotation)


def test_rotations_of_few_digits_are_projected_with_a_word(tmp_path):
    """Three digits are off orthonormal by 3e-4; the nearest rotation is near."""
    file = rough(tmp_path / "s.mha")
    with pytest.warns(TtusWarning, match="rotations off by 0.000. were projected"):
        found = read_poses(file)
    expected = read_poses(sequence(tmp_path / "t.mha"))
    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-3)
    gram = found.rotation @ found.rotation.transpose(0, 2, 1)
    np.testing.assert_allclose(gram, np.tile(np.eye(3), (5, 1, 1)), atol=1e-12)
    file.write_text(file.read_text().replace("0.9803", "0.99"))
    refuses(FileError, "not a rotation matrix", read_poses, file)


def rough(file):
    """Rotations written with three digits, and one number of them wrong by 2e-4."""
    words = []
    text = sequence(file).read_bytes().split(b"ElementDataFile")[0].decode()
    for line in text.splitlines():
        name, _, values = line.partition(" = ")
        if name.endswith("TrackerTransform"):
            values = " ".join(f"{float(v):.4g}"[:6] for v in values.split())
        words.append(f"{name} = {values}")
    near = [w.replace("0.9801", "0.9803") for w in words]
    file.write_text("\n".join([*near, "ElementDataFile = LOCAL\n"]))
    return file

"""PLUS sequence files: transforms in mm, status, times."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.hostile import only_our_errors
from ttus_opt.core.errors import FileError
from ttus_opt.sensors.plus_sequence import read_plus_sequence

HEAD = "ObjectType = Image\nNDims = 3\nDimSize = 2 2 6\nElementType = MET_UCHAR\n"


def sequence(
    file: Path, names: tuple[str, ...] = ("ProbeToTracker",), bad: int = 3
) -> Path:
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


def test_a_sequence(tmp_path: Path) -> None:
    found = read_plus_sequence(sequence(tmp_path / "s.mha"))
    np.testing.assert_allclose(found.time, 100 + 0.05 * np.array([0, 1, 2, 4, 5]))
    np.testing.assert_allclose(found.position[3], [0.040, 0.020, -0.005])
    turn = Rotation.from_matrix(found.rotation[4]).as_rotvec()
    np.testing.assert_allclose(turn, [0, 0, 0.5], atol=1e-5)
    assert found.segment.tolist() == [0, 0, 0, 1, 1]  # not bridged
    assert found.force is None


def test_several_transforms_are_named(tmp_path: Path) -> None:
    names = ("ProbeToTracker", "ReferenceToTracker")
    file = sequence(tmp_path / "s.mha", names)
    with pytest.raises(FileError, match="one of ProbeToTracker, ReferenceToTracker"):
        read_plus_sequence(file)
    for word in ("ReferenceToTracker", "ReferenceToTrackerTransform"):
        assert len(read_plus_sequence(file, word)) == 5
    with pytest.raises(FileError, match="no transform Stylus"):
        read_plus_sequence(file, "Stylus")


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("= OK", "= MISSING", "in view"),
        ("ProbeToTrackerTransform", "Image", "no transforms"),
        ("Seq_Frame0001_Timestamp", "Other", "no Timestamp"),
        ("= 1.000000", "= 1.0 2.0", "16 numbers"),
        ("= 1.000000", "= nan", "not finite"),
        ("= 1.000000", "= one", "one"),
        ("ObjectType = Image", "solid probe", "not a MetaImage"),
        ("Timestamp = 100.050", "Timestamp = 100.000", "increase"),
    ],
)
def test_what_is_none(tmp_path: Path, old: str, new: str, words: str) -> None:
    file = sequence(tmp_path / "s.mha")
    content = file.read_bytes().replace(old.encode(), new.encode())
    file.write_bytes(content)
    with pytest.raises(FileError, match=words) as told:
        read_plus_sequence(file)
    assert "\n" not in str(told.value)


@pytest.mark.parametrize("n", [60, pytest.param(3000, marks=pytest.mark.slow)])
def test_mutations(tmp_path: Path, n: int) -> None:
    only_our_errors([sequence(tmp_path / "s.mha")], read_plus_sequence, n)

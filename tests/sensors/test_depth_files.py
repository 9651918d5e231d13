"""Depth images as files: units, what is no depth, damage."""

import cv2
import numpy as np
import pytest

from tests.kit import FileError, InputError, refuses
from ttus_opt.sensors.depth_files import read_depth

DEPTH = np.full((20, 24), 0.8)
DEPTH[3, 4], DEPTH[5, 6] = 0.9, np.nan


def written(folder, name, values):
    file = folder / name
    if file.suffix == ".npy":
        np.save(file, values)
    else:
        assert cv2.imwrite(str(file), values)
    return file


def whole(depth):
    return np.nan_to_num(np.rint(1e3 * depth)).astype(np.uint16)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("a.png", whole(DEPTH)),
        ("a.tiff", whole(DEPTH)),
        ("a.tif", DEPTH.astype(np.float32)),
        ("a.npy", DEPTH),
        ("b.npy", DEPTH.astype(np.float32)[..., None][..., 0]),
        ("c.npy", whole(DEPTH).astype(np.int32)),
    ],
)
def test_whole_millimetres_and_metres(tmp_path, name, values):
    found, _ = read_depth(written(tmp_path, name, values))
    np.testing.assert_allclose(found, DEPTH, rtol=1e-6)


def test_a_stated_unit(tmp_path):
    file = written(tmp_path, "a.npy", 1e3 * DEPTH)
    np.testing.assert_allclose(read_depth(file, "mm")[0], DEPTH)
    refuses(InputError, "unit='mm'", read_depth, file)
    refuses(InputError, "unit must be", read_depth, file, "inch")


def test_where_nothing_was_measured(tmp_path):
    values = DEPTH.copy()
    values[0, :4] = [0.0, -1.0, np.inf, np.nan]
    found, _ = read_depth(written(tmp_path, "a.npy", values))
    assert np.isnan(found[0, :4]).all()
    assert np.isfinite(found).sum() == DEPTH.size - 5
    counts = whole(DEPTH)
    counts[0, 0] = 65535  # saturated
    assert np.isnan(read_depth(written(tmp_path, "a.png", counts))[0][0, 0])


@pytest.mark.parametrize(
    ("name", "values", "words"),
    [
        ("a.png", np.full((20, 24), 200, np.uint8), "picture for the eye"),
        ("a.png", np.full((20, 24, 3), 200, np.uint16), "colour picture"),
        ("a.npy", np.full((20, 24, 3), 0.8), "colour picture"),
        ("a.npy", np.full(500, 0.8), "height, width"),
        ("a.npy", np.full((4, 4), 0.8), "16 or more a side"),
        ("a.npy", np.full((20, 24), 0.8, complex), "expected numbers"),
        ("a.npy", np.zeros((20, 24)), "no pixel has a depth"),
        ("a.npy", np.full((20, 24), np.nan), "no pixel has a depth"),
        ("a.npy", np.full((20, 24), -0.8), "looks along -z"),
        ("a.npy", np.full((20, 24), 80.0), "unit='cm'"),
        ("a.png", np.full((20, 24), 1, np.uint16), "unit='m'"),
        ("a.png", np.full((20, 24), 20, np.uint16), "another unit"),
    ],
)
def test_what_is_no_depth_image(tmp_path, name, values, words):
    with pytest.raises((FileError, InputError), match=words) as told:
        read_depth(written(tmp_path, name, values))
    assert "\n" not in str(told.value)
    assert name in str(told.value)


def test_other_files(tmp_path):
    refuses(FileError, "not found", read_depth, tmp_path / "a.png")
    (tmp_path / "a.jpg").write_bytes(b"x")
    refuses(FileError, "suffix", read_depth, tmp_path / "a.jpg")
    (tmp_path / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n nothing")
    refuses(FileError, "damaged", read_depth, tmp_path / "a.png")

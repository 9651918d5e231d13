"""The section ``scan``: each value is told, and what excludes another fails."""

import numpy as np
import pytest

from tests.kit import FileError, refuses
from ttus_opt.probe.held import USUAL
from ttus_opt.session.scan_description import Scan, read_scan
from ttus_opt.session.section import Section

STILL = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]
ASIDE = [0.1, 0.2, 0.3, 0.0, 0.0, 0.0, 1.0]


@pytest.fixture
def folder(tmp_path):
    for name in ("skin.nc", "cloud.ply", "a.png", "b.png", "lens.json", "other.json"):
        (tmp_path / name).touch()
    return tmp_path


def read(folder, **values):
    return read_scan(Section(folder / "session.yaml", "scan", values))


DEPTH = {
    "depth": ["a.png", "b.png"],
    "intrinsics": "lens.json",
    "camera_to_scan": [STILL, ASIDE],
}


def test_a_cloud_with_nothing_else_has_the_defaults(folder):
    found = read(folder, cloud="cloud.ply")
    expected = Scan(
        (folder / "cloud.ply",), (), None, False, None, None, None, False, (180, 60)
    )
    assert found == expected


def test_everything_about_a_cloud(folder):
    found = read(
        folder,
        cloud="cloud.ply",
        unit="mm",
        head=[0, 0.6, -0.8],
        prone=True,
        nodes=[90, 30],
    )
    assert (found.unit, found.prone, found.nodes) == ("mm", True, (90, 30))
    assert found.head == (0.0, 0.6, -0.8)


def test_depth_images_have_a_camera_each(folder):
    """One file of intrinsics is for all of them."""
    found = read(folder, **DEPTH, noise="stereo", refine=True, depth_kind="range")
    assert found.files == (folder / "a.png", folder / "b.png")
    assert (found.noise, found.refine) == ("stereo", True)
    lenses = [(c.lens, c.has_rays, c.depth_kind) for c in found.cameras]
    assert lenses == [(folder / "lens.json", False, "range")] * 2
    moved = np.eye(4)
    moved[:3, 3] = ASIDE[:3]
    for camera, motion in zip(found.cameras, (np.eye(4), moved), strict=True):
        np.testing.assert_allclose(camera.to_scan, motion)


def test_rays_take_the_place_of_intrinsics(folder):
    told = DEPTH | {"intrinsics": None, "rays": ["lens.json", "other.json"]}
    found = read(folder, **told)
    assert [c.lens.name for c in found.cameras] == ["lens.json", "other.json"]
    assert all(c.has_rays and c.depth_kind == "z" for c in found.cameras)


def test_a_stated_axis(folder):
    axis = read(folder, cloud="cloud.ply", axis_from="skin.nc").axis
    assert (axis.file, axis.held, axis.depth) == (folder / "skin.nc", USUAL, None)
    given = {"axis_from": "a.png", "probe_axes": ["-y", "x"], "axis_depth": 0.12}
    axis = read(folder, cloud="cloud.ply", **given).axis
    assert (axis.file, axis.held) == (folder / "a.png", ("-y", "x"))
    assert axis.depth == 0.12


ONE = {"cloud": "cloud.ply"}
AXIS = ONE | {"axis_from": "skin.nc"}


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({}, "scan needs one of cloud, surface, depth, got 0 of them"),
        (ONE | {"surface": "skin.nc"}, "got 2 of them"),
        (ONE | {"clouds": 1}, "scan.clouds is not known: did you mean cloud"),
        ({"cloud": ["cloud.ply", "skin.nc"]}, "scan.cloud is one file, got a list"),
        (ONE | {"refine": True}, "scan.refine is for depth images, cloud is given"),
        (ONE | {"rays": "lens.json"}, "scan.rays is for depth images"),
        (ONE | {"unit": "inch"}, "scan.unit must be "),
        (ONE | {"nodes": [9]}, "scan.nodes must be a list of 2 numbers"),
        (DEPTH | {"rays": "lens.json"}, "scan.rays and intrinsics say the same"),
        (DEPTH | {"intrinsics": None}, "scan.intrinsics is missing"),
        (DEPTH | {"camera_to_scan": [STILL]}, "has 1 entries for 2 depth images"),
        (
            DEPTH | {"intrinsics": 3 * ["lens.json"]},
            "scan.intrinsics has 3 entries for 2 depth images",
        ),
        (DEPTH | {"depth_kind": "y"}, "scan.depth_kind must be z or range"),
        (ONE | {"probe_axes": ["x", "y"]}, "scan.probe_axes is for axis_from"),
        (ONE | {"axis_depth": 0.1}, "scan.axis_depth is for axis_from"),
        (AXIS | {"prone": True}, "scan.prone says where the frame is"),
        (AXIS | {"head": [0, 0, 1]}, "scan.head says where the frame is"),
        (AXIS | {"probe_axes": ["x"]}, "scan.probe_axes must be two of"),
        (AXIS | {"probe_axes": ["x", "w"]}, "scan.probe_axes must be two of"),
        (AXIS | {"probe_axes": "xy"}, "scan.probe_axes must be two of"),
        (AXIS | {"probe_axes": [["x"], "y"]}, "scan.probe_axes must be two of"),
        (AXIS | {"axis_depth": "deep"}, "scan.axis_depth must be a finite number"),
    ],
)
def test_values_that_exclude_each_other(folder, values, words):
    refuses(FileError, words, read, folder, **values)

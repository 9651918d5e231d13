"""``ttus-opt surface`` of depth images."""

import json
import re

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.cli.conftest import empty, refused
from tests.sensors.cameras import Camera, measured, millimetres, see_ellipsoid
from tests.sensors.cameras import see_plane as plane
from ttus_opt.cli.cloud_options import CloudOptions
from ttus_opt.cli.depth_options import DepthOptions

CENTRE, SEMI_AXES = np.array([0.0, 0.11, 0.0]), np.array([0.17, 0.11, 0.35])
CAMERAS = tuple(
    Camera(eye, (0.0, 0.1, 0.0))
    for eye in ((0, 0.9, 0.1), (-0.6, 0.6, 0), (0.6, 0.6, 0))
)


@pytest.fixture(scope="module")
def scans(tmp_path_factory):
    """Three depth images of an ellipsoid on a bed, camera and poses."""
    folder = tmp_path_factory.mktemp("scans")
    rng = np.random.default_rng(0)
    lines = ["t,px,py,pz,qw,qx,qy,qz"]
    for k, camera in enumerate(CAMERAS):
        z = np.minimum(
            see_ellipsoid(camera, CENTRE, SEMI_AXES),
            plane(camera, np.array([0.0, 1.0, 0.0]), 0.0),
        )
        depth = measured(np.where(z < 1.6, z, np.nan), 0.001, 0.05, rng)
        assert cv2.imwrite(str(folder / f"{k}.png"), millimetres(depth))
        pose = camera.pose
        q = Rotation.from_matrix(pose[:3, :3]).as_quat(scalar_first=True)
        lines.append(",".join(f"{v:.9f}" for v in [k, *pose[:3, 3], *q]))
    (folder / "poses.csv").write_text("\n".join(lines) + "\n")
    told = {"K": CAMERAS[0].matrix.tolist(), "width": 160, "height": 120}
    (folder / "camera.json").write_text(json.dumps(told))
    return folder


def words(scans, *more):
    images = [str(scans / f"{k}.png") for k in range(3)]
    camera = ["--intrinsics", str(scans / "camera.json")]
    poses = ["--poses", str(scans / "poses.csv")]
    axis = ["--axis-origin", "0,0.1,0", "--axis-direction", "0,0,1"]
    size = ["--n-theta", "60", "--n-z", "16", "--z-range=-0.15,0.15"]
    return " ".join(["surface", *images, *camera, *poses, *axis, *size, *more])


def test_three_sides(run, scans, tmp_path):
    out = tmp_path / "surface.nc"
    noise = ["--noise", "time-of-flight:0.0012", "--json", "-o", str(out)]
    told = run(words(scans, *noise)).told
    assert len(told["dropped"]) == 3
    assert all(one["invalid"] > 0 for one in told["dropped"])
    assert told["refinements"] == []
    found = tt.Surface.load(out)
    points = found.axis.to_scan(found.points()[found.observed])
    scaled = (points - CENTRE) / SEMI_AXES
    f = np.linalg.norm(scaled, axis=1)
    off = np.abs((f - 1) * f / np.linalg.norm(scaled / SEMI_AXES, axis=1))
    assert found.observed.mean() > 0.5
    assert off.mean() < 1.0e-3
    assert np.percentile(off, 95) < 3.0e-3


def test_an_ellipsoid_is_too_round_to_be_refined(run, scans, tmp_path):
    pytest.importorskip("small_gicp", reason="needs ttus-opt[sensors]")
    out = tmp_path / "surface.nc"
    refused(run(words(scans, "--refine", "-o", str(out))), "slides on the others")
    assert not out.exists()


def test_the_frame_of_a_held_probe_and_a_later_scan(run, scans, tmp_path):
    """The probe's z into the patient, its y to the feet; then one scan more."""
    turn = Rotation.from_matrix([[-1, 0, 0], [0, 0, -1], [0, -1, 0]])
    q = ",".join(f"{v:.9f}" for v in turn.as_quat(scalar_first=True))
    (tmp_path / "probe.csv").write_text(f"t,px,py,pz,qw,qx,qy,qz\n0,0,0.24,0.05,{q}\n")
    first, second = tmp_path / "first.nc", tmp_path / "second.nc"
    lines = (scans / "poses.csv").read_text().splitlines()
    for k in (0, 1):
        one = "\n".join([lines[0], lines[k + 1]]) + "\n"
        (tmp_path / f"pose{k}.csv").write_text(one)
    front, left = (
        f"surface {scans / f'{k}.png'} --intrinsics {scans / 'camera.json'} "
        f"--poses {tmp_path / f'pose{k}.csv'}"
        for k in (0, 1)
    )
    held = f"--axis-from {tmp_path / 'probe.csv'}"
    size = "--n-theta 60 --n-z 16 --z-range=-0.1,0.1"
    assert run(f"{front} {held} {size} -o {first}").status == 0
    earlier = tt.Surface.load(first)
    np.testing.assert_allclose(earlier.axis.rotation, np.eye(3), atol=1e-6)
    np.testing.assert_allclose(earlier.axis.origin, [0, 0.11, 0.05], atol=0.005)
    told = run(f"{left} --update {first} --json -o {second}").told
    later = tt.Surface.load(second)
    assert told["kept"] > 0.05 and told["added"] > 0.01
    assert told["averaged"] > 0.8 * (told["averaged"] + told["replaced"])
    assert later.observed.mean() > earlier.observed.mean()
    np.testing.assert_array_equal(later.axis.rotation, earlier.axis.rotation)
    answer = run(f"{left} {held} --update {first} -o {second}")
    refused(answer, "--update keeps the surface's frame")
    answer = run(f"{front} {held} --probe-axes z,z -o {second}")
    refused(answer, "same axis of the probe")


SEEN = "0.png --intrinsics camera.json"


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ("0.png", "give --intrinsics or --rays"),
        ("0.png 1.png --intrinsics camera.json", "give --poses"),
        (f"{SEEN} --refine", "more than one scan"),
        (f"{SEEN} --poses poses.csv", "3 poses for 1 image"),
        # without advice by --columns, which is not an option here
        (f"{SEEN} --poses camera.json", r"t,px,py,pz,qw,qx,qy,qz, got [^;]+$"),
        (f"{SEEN} --noise loud", "noise must be one"),
        (f"{SEEN} --unit m", "another unit"),
        ("0.png --intrinsics poses.csv", "not a camera calibration"),
        ("poses.csv --noise structured-light", "need depth images"),
        ("poses.csv poses.csv", "expected one"),
        (f"{SEEN} --depth-kind disparity", "depth_kind|--depth-kind"),
        (f"{SEEN} --intrinsics camera.json", "one for all or one for each"),
        (f"{SEEN} --rays 0.png", "not both"),
        (
            "0.png 1.png 2.png --intrinsics camera.json --poses poses.csv --refine "
            "--pose-std 5,1",
            "--pose-std: a pose's standard deviations",
        ),
    ],
)
def test_bad_input_is_one_line(run, scans, output, monkeypatch, given, told):
    monkeypatch.chdir(scans)
    answer = run(f"surface {given} -o {output / 'surface.nc'}")
    refused(answer)
    assert re.search(told, answer.errors[0])
    assert empty(output)


def test_a_recording_of_several_topics_whose_suffix_is_in_capitals(tmp_path):
    pytest.importorskip("rosbags", reason="needs ttus-opt[sensors]")
    from tests.sensors.test_depth_bag import ALIGNED, recorded

    file = recorded(tmp_path / "two.bag", aligned=True).rename(tmp_path / "TWO.BAG")
    depth = DepthOptions(stream=f"{ALIGNED}/image_raw")
    found = depth.read(CloudOptions([file]))
    assert found.frames[0].topic == f"{ALIGNED}/image_raw"

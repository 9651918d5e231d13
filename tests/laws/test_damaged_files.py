"""Every reader of files: of damaged ones it raises the package's own errors alone."""

import json
from functools import partial

import cv2
import numpy as np
import pytest

import ttus_opt as tt
from tests.hostile import NUMBERS, only_our_errors
from tests.probe import test_rigid_motion as motions
from tests.probe import test_text_table as tables
from tests.scan.test_cloud import seeds
from tests.sensors import readings, test_intrinsics
from tests.sensors import test_marker_pose as photos
from tests.sensors.test_column_map import MAP
from tests.sensors.test_depth_bag import recorded
from tests.sensors.test_depth_files import whole
from tests.sensors.test_hand_eye import pairs
from tests.sensors.test_plus_sequence import sequence
from tests.sensors.test_ros_bag import recordings
from tests.sensors.test_stitching import poses_file
from tests.sensors.test_stream_formats import SAMPLES
from tests.sensors.test_streams import table
from ttus_opt.probe.rigid_motion import read_rigid_motion
from ttus_opt.sensors.column_map import read_column_map
from ttus_opt.sensors.depth_files import read_depth
from ttus_opt.sensors.hand_eye import hand_eye, read_pose_pairs
from ttus_opt.sensors.intrinsics import read_intrinsics
from ttus_opt.sensors.marker_pose import read_image
from ttus_opt.sensors.stitching import read_camera_poses
from ttus_opt.sensors.stream_files import raw_recordings, read_poses, read_wrenches
from ttus_opt.sensors.tool_load import identify_load
from ttus_opt.sensors.unprojection import read_unprojection
from ttus_opt.sensors.wrench_compensation import compensated

RNG = np.random.default_rng(0)
DEPTH = 0.8 + 0.01 * RNG.standard_normal((20, 24))
PAIRS = np.stack(pairs("fixed", 4), axis=1)
STAMPED = [f"{1_700_000_000 + i},{i}" + ",0.5" * 13 for i in range(3)]


def load_of(file):
    free = tt.read_trajectory(file)
    load = identify_load(free, readings.SENSOR, readings.DOWN)
    given = free, readings.SENSOR, load, readings.DOWN, np.zeros(3)
    compensated(*given, inertia=True)


def photo():
    seen = photos.looking([0.6, 0.1, 0.2], [0.02, -0.01, 0.35])
    return photos.drawn(seen)[200:280, 300:400]


#: Files by their names (text, array, picture or made into a path); what reads them
READERS = {
    "trajectory": (
        {
            "own.csv": "\n".join([",".join(tables.OURS), *tables.lines(","), ""]),
            "ros.csv": "\n".join([tables.ROS, *STAMPED, ""]),
        },
        tt.read_trajectory,
    ),
    "recordings": (SAMPLES, raw_recordings),
    "wrenches": ({"w.csv": table}, read_wrenches),
    "sequence": ({"s.mha": sequence}, read_poses),
    "camera poses": ({"p.csv": poses_file}, partial(read_camera_poses, n=2)),
    "load": (
        {"free.csv": readings.readings(readings.tilts(12), noise=0.01).save},
        load_of,
    ),
    "motion": (
        {
            "m.txt": partial(np.savetxt, X=motions.motion(), header="base to scan"),
            "m.npy": motions.motion(),
            "m.json": json.dumps(motions.motion().tolist()),
            "seven.csv": "0.1,0.2,0.3,0,0,0,1",
        },
        read_rigid_motion,
    ),
    "pairs": (
        {"p.json": json.dumps(PAIRS.round(6).tolist()), "p.npy": PAIRS},
        lambda file: hand_eye(*read_pose_pairs(file), "fixed"),
    ),
    "columns": ({"map.yaml": MAP}, read_column_map),
    "intrinsics": (
        {
            "a.yaml": test_intrinsics.OPENCV,
            "b.yaml": test_intrinsics.ROS,
            "c.yaml": test_intrinsics.MESSAGE,
            "d.json": json.dumps({"K": [500.0, 0, 9, 0, 500, 9, 0, 0, 1], "D": []}),
        },
        read_intrinsics,
    ),
    "rays": (
        {"a.npy": RNG.normal(size=(20, 24, 2)), "b.npy": np.ones((9, 9, 3), "f4")},
        read_unprojection,
    ),
    "depth": (
        {"a.png": whole(DEPTH), "b.tiff": DEPTH.astype("f4"), "d.npy": DEPTH},
        read_depth,
    ),
    "depth of a recording": ({"scan.bag": recorded}, read_depth),
    "wrenches of a recording": (recordings, read_wrenches),
    "photo": (
        {f"a.{suffix}": photo() for suffix in ("png", "jpg", "tiff")},
        read_image,
    ),
    "cloud": (seeds, tt.read_cloud),
}


def made(folder, files):
    """The files, written into a folder."""
    if callable(files):
        return files(folder)
    for name, content in files.items():
        file = folder / name
        if isinstance(content, str):
            file.write_text(content)
        elif callable(content):
            content(file)
        elif file.suffix == ".npy":
            np.save(file, content)
        else:
            assert cv2.imwrite(str(file), content)
    return [folder / name for name in files]


@pytest.mark.parametrize("n", NUMBERS)
@pytest.mark.parametrize("kind", READERS)
@pytest.mark.filterwarnings("ignore")
def test_damaged_files_raise_nothing_but_our_own(kind, n, tmp_path):
    for package, needing in (("yaml", "columns intrinsics"), ("rosbags", "recording")):
        if any(word in needing for word in kind.split()):
            pytest.importorskip(package, reason="needs ttus-opt[sensors]")
    files, read = READERS[kind]
    only_our_errors(made(tmp_path, files), read, n)

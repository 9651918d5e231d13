"""A sample of every device, and the page with what the command says of each.

``python -m tests.sensors.device_samples`` writes the page anew; its test compares.
"""

import contextlib
import io
import json
import shlex
import shutil
import struct
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from tests.sensors import test_depth_bag, test_ros_bag
from tests.sensors.test_intrinsics import FILE_STORAGE, OPEN3D, OPENCV, REALSENSE
from tests.sensors.test_plus_sequence import apart, rough, sequence
from tests.sensors.test_stream_formats import SAMPLES, plotjuggler, robotiq
from ttus_opt.cli import main

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "device-samples.md"

HEAD = """# What the command says of each device

One sample for each row of [devices and their files](devices-and-formats.md), and what
`ttus-opt doctor` says of it. The samples are ours: a short motion of known numbers,
written in the layout that the maker or the standard documents, with the holes that real
files have. Nothing is copied from a maker's file.

The readers were also tried on real files: 68 sequences of
[PlusLibData](https://github.com/PlusToolkit/PlusLibData) (BSD-3-Clause), of which all
with transforms and times are read, twelve of their transforms with rotations off by
3e-4 to 5e-4, and marker files of
[opensim-models](https://github.com/opensim-org/opensim-models).

(`python -m tests.sensors.device_samples` writes this page, and a test compares.)
"""


class Sample(NamedTuple):
    """A file, how it is made, and the heading and origin where a device begins."""

    file: str
    make: Callable[[Path], object]
    device: str = ""
    origin: str = ""


def text(content):
    return lambda file: file.write_text(content)


def ros(recorded, kind):
    """A recording of a test's own maker under another name."""

    def make(file):
        with tempfile.TemporaryDirectory() as folder:
            made = recorded(Path(folder), kind)
            if made.is_dir() and file.suffix:
                (made,) = made.glob(f"*{file.suffix}")
            shutil.move(made, file)

    return make


ROWS = [
    Sample(
        "scan.bag",
        test_depth_bag.recorded,
        "RealSense",
        "Topics as librealsense's recorder names them (`ros_file_format.h`), the unit "
        "of a D405; intrinsics by the fields of `rs2_intrinsics`.",
    ),
    Sample("realsense.json", text(json.dumps(REALSENSE))),
    Sample(
        "open3d.json",
        text(json.dumps(OPEN3D)),
        "Open3D, OpenCV",
        "`write_pinhole_camera_intrinsic` (column by column), and `cv2.FileStorage`.",
    ),
    Sample("opencv.xml", text(FILE_STORAGE)),
    Sample("opencv.yaml", text(OPENCV)),
    Sample(
        "toolbox.csv",
        SAMPLES["toolbox.csv"],
        "NDI",
        "An export of NDI ToolBox, and the CSV of the Combined API's sample program.",
    ),
    Sample("api.csv", SAMPLES["api.csv"]),
    Sample(
        "motive.csv",
        SAMPLES["motive.csv"],
        "OptiTrack, Vicon and markers",
        "Motive's data export, version 1.23; OpenSim's description of TRC; the "
        "ASCII export of Nexus and Tracker.",
    ),
    Sample("press.trc", SAMPLES["press.trc"]),
    Sample("vicon.csv", SAMPLES["vicon.csv"]),
    Sample(
        "ati.csv",
        SAMPLES["ati.csv"],
        "ATI, Robotiq",
        "The log that the Net F/T's demo program collects, with a lost packet "
        "and an error status; a logger's table with its units in brackets.",
    ),
    Sample("robotiq.csv", robotiq),
    Sample(
        "rtde.csv",
        SAMPLES["rtde.csv"],
        "Universal Robots",
        "`record.py` of the RTDE client library; units and frame by the RTDE guide.",
    ),
    Sample(
        "run.bag",
        ros(test_ros_bag.recorded, "ros1"),
        "ROS 1, ROS 2, PlotJuggler",
        "Messages of `geometry_msgs`, `nav_msgs` and `tf2_msgs`, written by "
        "rosbags; PlotJuggler's CSV.",
    ),
    Sample("run.mcap", ros(test_ros_bag.recorded, "mcap")),
    Sample("arm.bag", ros(test_ros_bag.recorded_frames, "ros1")),
    Sample("alone.db3", ros(test_ros_bag.recorded_frames, "sqlite3")),
    Sample("plotjuggler.csv", plotjuggler),
    Sample(
        "press.igs.mha",
        sequence,
        "PLUS, 3D Slicer",
        "The sequence metafile of the PLUS user manual; MetaImage and "
        "NRRD; rotations of three digits.",
    ),
    Sample("press.mhd", apart),
    Sample("press.nrrd", apart),
    Sample("rough.mha", rough),
    Sample(
        "tum.txt",
        SAMPLES["tum.txt"],
        "TUM, EuRoC",
        "File formats of TUM's RGB-D benchmark, and of EuRoC's state estimates.",
    ),
    Sample("euroc.csv", SAMPLES["euroc.csv"]),
]


def said(words):
    """What a command of ttus-opt says on stdout."""
    out = io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.suppress(SystemExit):
        main(shlex.split(words))
    return out.getvalue()


def block(command, words=""):
    return f"```console\n$ ttus-opt {command}\n{said(words or command)}```\n"


def streamed():
    """Messages of OpenIGTLink: POSITION, TDATA and NDARRAY, at 20 Hz."""
    from tests.sensors.test_open_igt_link import Packed, transform

    turn = Rotation.from_rotvec([0.3, -0.2, 0.5])
    for i in range(40):
        place = [10.0 + i, 20.0, 30.0]
        columns = np.c_[turn.as_matrix(), place].T.ravel()
        numbers = np.arange(6.0) + i
        bodies = {
            ("POSITION", "Stylus"): struct.pack(">7f", *place, *turn.as_quat()),
            ("TDATA", "Tracker"): struct.pack(">20sBB12f", b"Probe", 2, 0, *columns),
            ("NDARRAY", "Force"): struct.pack(">BBH6d", 11, 1, 6, *numbers),
        }
        for (kind, device), body in bodies.items():
            message = Packed(kind, body, device)
            message.timestamp = 100.0 + 0.05 * i
            yield message
        yield transform(i, "NeedleToTracker")


def recorded():
    """The last device's section: a server of this process, and the file it gives."""
    from tests.sensors.test_open_igt_link import serving

    command = (
        "record localhost:{} --poses live.csv --wrenches force.csv --pose-device Probe"
    )
    with serving([*streamed()], closing=True) as port, warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the server closes at the end
        return block(command.format(18944), command.format(port))


def page():
    """The whole page."""
    parts = [HEAD]
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        for sample in ROWS:
            sample.make(Path(sample.file))
            if sample.device:
                parts.append(f"## {sample.device}\n\n{sample.origin}\n")
            parts.append(block(f"doctor {sample.file}"))
        parts.append(
            "## OpenIGTLink\n\nBodies by the protocol's tables (version 3), sent by a "
            "test's server: a tool of TDATA, a stylus of POSITION, a needle of "
            "TRANSFORM, and forces as NDARRAY.\n"
        )
        parts.append(recorded())
    return "\n".join(parts)


if __name__ == "__main__":
    PAGE.write_text(page(), encoding="utf-8")
    sys.stdout.write(f"{PAGE}\n")

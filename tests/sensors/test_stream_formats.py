"""Every format of the table, by a small sample in its maker's documented layout."""

import itertools
from collections.abc import Collection
from typing import NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, TtusWarning, refuses
from ttus_opt.sensors.column_map import read_column_map
from ttus_opt.sensors.stream_files import (
    FORMATS,
    format_of,
    raw_recordings,
    read_poses,
    read_recording,
    read_wrenches,
)

TIME = 0.05 * np.arange(8)
PLACE = np.outer(TIME, [0.2, 0.1, 0.0]) + np.array([0.1, -0.2, 1.5])
TURN = Rotation.from_rotvec(np.outer(TIME, [0.3, -0.5, 0.8]) + np.array([0.1, 0, 0]))
FORCE = np.outer(TIME, [1.0, -2.0, 30.0]) + np.array([0.0, 0.0, 5.0])
TORQUE = 0.1 * FORCE[:, ::-1]

#: Frames that the trackers of these samples did not see
LOST = (3, 4)
SEEN = np.array([i for i in range(8) if i not in LOST])


def lines(*rows):
    return "".join(",".join(map(str, row)) + "\n" for row in rows)


class Motion(NamedTuple):
    """What a tracker sees, and the frames that it does not."""

    time: np.ndarray = 1000 + TIME
    place: np.ndarray = PLACE
    turn: Rotation = TURN
    lost: Collection[int] = LOST


SEEN_HERE = Motion()


def ndi_toolbox(file, seen=SEEN_HERE):
    """ToolBox: two tools, markers behind each, Missing frames without numbers."""
    pose = ["Q0", "Qx", "Qy", "Qz", "Tx", "Ty", "Tz", "Error"]
    markers = ["Markers", "State", "Tx", "Ty", "Tz"]
    head: list[object] = ["Tools"]
    for port, name in ((1, "Probe"), (2, "Stylus")):
        head += [f"Port 0x0{port}: {name}  s/n:3E4C880{port}"]
        head += ["Frame", "Time [sec]", "Face", "State", *pose, *markers]
    rows = [head]
    for i, t in enumerate(seen.time):
        row: list[object] = [2]
        for tool in range(2):
            row += [head[1 + 18 * tool], 600 + 3 * i, t, 0]
            if i in seen.lost and tool == 0:
                row += ["Missing", *[""] * 8, 1, "Missing", "", "", ""]
            else:
                q = seen.turn[i].as_quat(scalar_first=True)
                place = 1e3 * seen.place[i] + 100 * tool
                row += ["OK", *q, *place, 0.1, 1, "OK", *place]
        rows.append(row)
    file.write_text(lines(*rows))
    return file


def ndi_api(file):
    """The Combined API's sample program: frame numbers only, a header that is cut."""
    text = "#Tools,ToolInfo,Frame#,PortHandle,Face#,TransformStatus,Q0,Qx,Qy,Qz,"
    text += "Tx,Ty,Tz,Error,Markers,State,Tx,Ty,Tz\n"
    for i in range(8):
        q = TURN[i].as_quat(scalar_first=True)
        row = [1, "8700340 s/n:3AB", 600 + 3 * i, "Port:1", 0]
        row += ["Missing", *[""] * 8] if i in LOST else ["OK", *q, *1e3 * PLACE[i], 0.1]
        text += lines([*row, 2, "OK", 1, 2, 3, "OK", 4, 5, 6])
    file.write_text(text)
    return file


def motive(file):
    names = ["Probe"] * 7
    head = "Format Version,1.23,Take Name,t,Rotation Type,Quaternion,Length Units,"
    head += "Millimeters,Coordinate Space,Global\n\n"
    head += lines(["", "Type", *["Rigid Body"] * 7], ["", "Name", *names])
    head += lines(["", "ID", *["AB"] * 7])
    head += lines(["", "", *["Rotation"] * 4, *["Position"] * 3])
    head += "Frame,Time (Seconds),X,Y,Z,W,X,Y,Z\n"
    rows = []
    for i, t in enumerate(TIME):
        cells = [""] * 7 if i in LOST else [*TURN[i].as_quat(), *1e3 * PLACE[i]]
        rows.append([i, t, *cells])
    file.write_text(head + lines(*rows))
    return file


#: Markers of a body whose first is its origin, the second along x, the third in xy [m]
BODY = np.array([[0, 0, 0], [0.06, 0, 0], [0.01, 0.05, 0], [0.0, 0.02, 0.03]])


def markers(i):
    return np.asarray(BODY @ TURN[i].as_matrix().T + PLACE[i])


def trc(file):
    text = "PathFileType\t4\t(X/Y/Z)\tpress.trc\n"
    text += "DataRate\tCameraRate\tNumFrames\tNumMarkers\tUnits\n20\t20\t8\t4\tmm\n"
    text += "Frame#\tTime\t" + "\t\t\t".join("ABCD") + "\t\t\n"
    text += "\t\t" + "\t".join(f"{x}{m}" for m in (1, 2, 3, 4) for x in "XYZ") + "\n\n"
    for i, t in enumerate(TIME):
        cells = [f"{v:.9f}" for v in 1e3 * markers(i).ravel()]
        if i in LOST:
            cells[:6] = [""] * 6
        text += "\t".join([str(i + 1), f"{t:.9f}", *cells]) + "\n"
    file.write_text(text)
    return file


def vicon(file):
    """Tracker's objects with quaternions, Nexus' trajectories, and a force plate."""
    text = "Objects\n20\n,,Global Angle Probe:Probe,,,,,,\n"
    text += "Frame,Sub Frame,RX,RY,RZ,RW,TX,TY,TZ\n,,,,,,mm,mm,mm\n"
    for i in range(8):
        cells = [""] * 7 if i in LOST else [*TURN[i].as_quat(), *1e3 * PLACE[i]]
        text += lines([i + 1, 0, *cells])
    text += "\nTrajectories\n20\n,,P:A,,,P:B,,,P:C,,,P:D,,\n"
    text += f"Frame,Sub Frame{',X,Y,Z' * 4}\n,{',mm' * 12}\n"
    for i in range(8):
        cells = [""] * 12 if i in LOST else [*1e3 * markers(i).ravel()]
        text += lines([i + 1, 0, *cells])
    text += "\nDevices\n40\n,,Plate - Force,,,Plate - Moment,,\n"
    text += "Frame,Sub Frame,Fx,Fy,Fz,Mx,My,Mz\n,,N,N,N,N.mm,N.mm,N.mm\n"
    for i in range(8):
        text += lines([i // 2 + 1, i % 2, *FORCE[i], *1e3 * TORQUE[i]])
    file.write_text(text)
    return file


class Felt(NamedTuple):
    """What a force sensor reads at its rate [Hz], its lost packets and errors."""

    rate: int = 20
    force: np.ndarray = FORCE
    torque: np.ndarray = TORQUE
    lost: Collection[int] = (3,)
    failed: Collection[int] = (4,)


FELT_HERE = Felt()


def ati(file, counts=True, felt=FELT_HERE):
    """The demo program of ATI's Net F/T, with a lost packet and an error status."""
    text = f"Start Time: 3/12/26 10:01 AM\nRDT Sample Rate: {felt.rate}\n"
    text += '"PLEASE NOTE: the rate"\n'
    text += "Force Units: N\nCounts per Unit Force: 1000000.0\nTorque Units: Nmm\n"
    text += "Counts per Unit Torque: 1000.0\n"
    text += "Status (hex), RDT Sequence, F/T Sequence, Fx, Fy, Fz, Tx, Ty, Tz, Time\n"
    for i in range(len(felt.force)):
        if i in felt.lost:
            continue
        status = "80010000" if i in felt.failed else "0"
        values = np.r_[felt.force[i], 1e3 * felt.torque[i]]
        if counts:
            values = np.round(values * np.repeat([1e6, 1e3], 3))
        text += lines([status, 50 + i, 9 * i, *values, "10:01:01 AM"])
    file.write_text(text)
    return file


def rtde(file):
    """Universal Robots' record.py: blanks, rotation vectors, both in one table."""
    names = ["timestamp", *[f"actual_q_{i}" for i in range(6)]]
    names += [f"actual_TCP_{kind}_{i}" for kind in ("pose", "force") for i in range(6)]
    rows = [
        [
            100 + TIME[i],
            *[0.5] * 6,
            *PLACE[i] / 10,
            *TURN[i].as_rotvec(),
            *FORCE[i],
            *TORQUE[i],
        ]
        for i in range(8)
    ]
    text = [" ".join(names), *[" ".join(map(str, row)) for row in rows]]
    file.write_text("\n".join(text) + "\n")
    return file


def tum(file, header=True):
    text = "# ground truth trajectory\n# file: 'x.bag'\n" if header else ""
    text += "# timestamp tx ty tz qx qy qz qw\n" if header else ""
    for i in range(8):
        row = [1305031098.6659 + TIME[i], *PLACE[i], *TURN[i].as_quat()]
        text += " ".join(f"{v:.9f}" for v in row) + "\n"
    file.write_text(text)
    return file


def euroc(file):
    names = ["#timestamp [ns]", *[f" p_RS_R_{x} [m]" for x in "xyz"]]
    names += [f" q_RS_{x} []" for x in "wxyz"]
    rows = [
        [int(1.4e18) + int(5e7) * i, *PLACE[i], *TURN[i].as_quat(scalar_first=True)]
        for i in range(8)
    ]
    file.write_text(lines(list(names), *rows))
    return file


def plotjuggler(file):
    """Names of topic and field with slashes; whole seconds and nanoseconds apart."""
    names = ["/p/header.stamp.sec", "/p/header.stamp.nanosec"]
    names += [f"/p/pose.position.{x}" for x in "xyz"]
    names += [f"/p/pose.orientation.{x}" for x in "xyzw"]
    rows = [
        [1_700_000_000 + i // 4, 250_000_000 * (i % 4), *PLACE[i], *TURN[i].as_quat()]
        for i in range(8)
    ]
    file.write_text(lines(list(names), *rows))
    return file


def in_ms_and_mm():
    """Times [ms], forces [N] and torques [N mm]."""
    columns = zip(1e3 * TIME, FORCE, 1e3 * TORQUE, strict=True)
    return [[t, *f, *m] for t, f, m in columns]


def robotiq(file):
    """A name, an empty line, and units in brackets of both kinds."""
    names = ["Time (ms)", "Fx (N)", "Fy (N)", "Fz (N)"]
    names += ["Mx [Nmm]", "My [Nmm]", "Mz [Nmm]"]
    file.write_text("Robotiq FT 300\n\n" + lines(list(names), *in_ms_and_mm()))
    return file


SAMPLES = {
    "toolbox.csv": ndi_toolbox,
    "api.csv": ndi_api,
    "motive.csv": motive,
    "press.trc": trc,
    "vicon.csv": vicon,
    "ati.csv": ati,
    "rtde.csv": rtde,
    "tum.txt": tum,
    "euroc.csv": euroc,
}


@pytest.mark.parametrize(
    ("name", "stream", "begin"),
    [
        ("toolbox.csv", "Probe", 1000.0),
        ("motive.csv", None, 0.0),
        ("press.trc", "markers", 0.0),
        ("vicon.csv", "Probe:Probe", 0.0),
        ("vicon.csv", "P", 0.0),
    ],
)
def test_trackers(tmp_path, name, stream, begin):
    """Positions, rotations and times as they were written; what was lost is a gap."""
    found = read_poses(SAMPLES[name](tmp_path / name), stream)
    np.testing.assert_allclose(found.time - begin, TIME[SEEN], atol=1e-9)
    np.testing.assert_allclose(found.position, PLACE[SEEN], atol=1e-8)
    apart = Rotation.from_matrix(found.rotation) * TURN[SEEN].inv()
    assert apart.magnitude().max() < 1e-6
    assert found.segment.tolist() == [0, 0, 0, 1, 1, 1]


def test_frames_without_times_are_counted_aloud(tmp_path):
    with pytest.warns(TtusWarning, match="frame numbers at 60 Hz"):
        found = read_poses(ndi_api(tmp_path / "api.csv"))
    np.testing.assert_allclose(np.diff(found.time), [0.05, 0.05, 0.15, 0.05, 0.05])
    np.testing.assert_allclose(found.position, PLACE[SEEN])


def test_several_tools_are_named(tmp_path):
    file = ndi_toolbox(tmp_path / "toolbox.csv")
    refuses(
        FileError, "several tools of poses: Probe, Stylus: choose one", read_poses, file
    )
    other = read_poses(file, "Stylus")  # its own state, not the probe's
    np.testing.assert_allclose(other.position, PLACE + 0.1)


@pytest.mark.parametrize("counts", [True, False])
def test_a_log_of_ati(tmp_path, counts):
    """Counts by their own factor, sequence numbers as times, errors left out."""
    found = read_wrenches(ati(tmp_path / "ati.csv", counts))
    kept = [0, 1, 2, 5, 6, 7]
    np.testing.assert_allclose(found.time, TIME[kept])
    np.testing.assert_allclose(found.force, FORCE[kept], atol=1e-6)
    np.testing.assert_allclose(found.torque, TORQUE[kept], atol=1e-6)


def test_a_force_plate(tmp_path):
    file = vicon(tmp_path / "vicon.csv")
    found = read_wrenches(file)
    np.testing.assert_allclose(found.time, 0.5 * TIME)
    np.testing.assert_allclose(found.torque, TORQUE)
    text = file.read_text()
    file.write_text(text + text[text.index("\nDevices") :])
    refuses(FileError, "several objects of wrenches: Plate, Plate", read_wrenches, file)
    # an object without places or moments without forces
    for column, left in (("TX", ["P", "Plate"]), ("Fx", ["Probe:Probe", "P"])):
        file.write_text(text.replace(column, "?"))
        assert [each.name for each in raw_recordings(file)] == left


def test_a_robot_of_universal(tmp_path):
    found = read_recording(rtde(tmp_path / "rtde.csv"))
    np.testing.assert_allclose(found.position, PLACE / 10)
    assert (Rotation.from_matrix(found.rotation) * TURN.inv()).magnitude().max() < 1e-7
    assert found.force is not None and found.torque is not None
    np.testing.assert_allclose(found.torque, TORQUE)
    assert read_wrenches(tmp_path / "rtde.csv").force.shape == (8, 3)


@pytest.mark.parametrize("header", [True, False])
def test_tum(tmp_path, header):
    words = "tx,ty,tz beside a quaternion" if header else "no header: read as t px"
    with pytest.warns(TtusWarning, match=words):
        found = read_poses(tum(tmp_path / "tum.txt", header))
    np.testing.assert_allclose(found.time - found.time[0], TIME, atol=1e-6)
    np.testing.assert_allclose(found.position, PLACE, atol=1e-9)
    assert (Rotation.from_matrix(found.rotation) * TURN.inv()).magnitude().max() < 1e-8


def test_euroc(tmp_path):
    found = read_poses(euroc(tmp_path / "euroc.csv"))
    np.testing.assert_allclose(found.time - 1.4e9, TIME, atol=1e-6)
    np.testing.assert_allclose(found.position, PLACE)


def test_angles_of_an_unstated_kind_are_not_guessed(tmp_path):
    text = "Segments\n20\n,,Probe:Probe,,,,,\nFrame,Sub Frame,RX,RY,RZ,TX,TY,TZ\n"
    text += ",,deg,deg,deg,mm,mm,mm\n1,0,1,2,3,4,5,6\n2,0,1,2,3,4,5,6\n"
    (tmp_path / "v.csv").write_text(text)
    refuses(FileError, "Euler or helical is not stated", read_poses, tmp_path / "v.csv")


def test_euler_angles_of_motive(tmp_path):
    """Its rotation type names the axes; SciPy turns back."""
    file = motive(tmp_path / "m.csv")
    text = file.read_text().replace("Quaternion", "XYZ")
    head, body = text.split("Frame,Time (Seconds),X,Y,Z,W,X,Y,Z\n")
    head = head.replace(",Rotation,Rotation,Rotation,Rotation", ",Rotation" * 3)
    head = head.replace(",Probe" * 7, ",Probe" * 6).replace(
        ",Rigid Body" * 7, ",Rigid Body" * 6
    )
    rows = [line.split(",") for line in body.splitlines()]
    for i, row in enumerate(rows):
        angles = TURN[i].as_euler("XYZ", degrees=True)
        row[2:6] = ["", "", ""] if i in LOST else [f"{a:.9f}" for a in angles]
    file.write_text(f"{head}Frame,Time (Seconds),X,Y,Z,X,Y,Z\n{lines(*rows)}")
    found = read_poses(file)
    apart = Rotation.from_matrix(found.rotation) * TURN[SEEN].inv()
    assert apart.magnitude().max() < 1e-9


def test_markers_of_a_body_that_are_seen_in_part(tmp_path):
    """Three of four markers give the pose too, two do not."""
    file = trc(tmp_path / "a.trc")
    rows = file.read_text().splitlines()
    cells = rows[6].split("\t")
    rows[6] = "\t".join([*cells[:2], "", "", "", *cells[5:]])  # the origin's marker
    file.write_text("\n".join(rows) + "\n")
    found = read_poses(file)
    np.testing.assert_allclose(found.position, PLACE[SEEN], atol=1e-8)


def test_markers_of_no_rigid_body_are_told(tmp_path):
    """One of four wanders by 0.1 m, so that the rigid body is off by 5 cm."""
    file = trc(tmp_path / "a.trc")
    rows = file.read_text().splitlines()
    for i, row in enumerate(rows[6:]):
        *cells, last = row.split("\t")
        rows[6 + i] = "\t".join([*cells, f"{float(last) + 200 * (i % 2):.6f}"])
    file.write_text("\n".join(rows) + "\n")
    with pytest.warns(TtusWarning, match=r"move by \d\d mm against each other"):
        read_poses(file)


def test_two_columns_of_one_time_and_units(tmp_path):
    """Seconds and nanoseconds are found by their names, or told; so are units."""
    found = read_poses(plotjuggler(tmp_path / "a.csv"))
    np.testing.assert_allclose(np.diff(found.time), 0.25, atol=1e-6)
    head, *told = (tmp_path / "a.csv").read_text().splitlines()
    names = ["whole", "rest", "tip_x", *head.split(",")[3:]]
    rows = [[float(cell) for cell in line.split(",")] for line in told]
    rows = [[*row[:2], 1e3 * row[2], *row[3:]] for row in rows]
    (tmp_path / "b.csv").write_text(lines(list(names), *rows))
    told = read_column_map("t=whole+rest[ns],px=tip_x[mm]")
    again = read_poses(tmp_path / "b.csv", columns=told)
    np.testing.assert_allclose(again.time, found.time)
    np.testing.assert_allclose(again.position, PLACE)
    with pytest.raises(FileError, match="px has the unit 'furlong'"):
        read_poses(tmp_path / "b.csv", columns={**told, "px": "tip_x[furlong]"})


def test_units_of_the_header_and_below_it(tmp_path):
    rows = in_ms_and_mm()
    robotiq(tmp_path / "a.csv")
    bare: list[object] = ["t", "fx", "fy", "fz", "tx", "ty", "tz"]
    units: list[object] = ["ms", "N", "N", "N", "N.mm", "N.mm", "N.mm"]
    (tmp_path / "b.csv").write_text(lines(bare, units, *rows))
    for name in ("a.csv", "b.csv"):
        found = read_wrenches(tmp_path / name)
        (raw,) = raw_recordings(tmp_path / name)
        assert raw.units_stated and raw.notes[0].startswith("t in ms, fx fy fz in N, ")
        np.testing.assert_allclose(found.time, TIME)
        np.testing.assert_allclose(found.torque, TORQUE)


def test_a_file_has_one_format(tmp_path):
    titles = {
        name: format_of(make(tmp_path / name)).title for name, make in SAMPLES.items()
    }
    assert titles["tum.txt"] == titles["rtde.csv"] == titles["euroc.csv"] == "table"
    assert titles["toolbox.csv"] == titles["api.csv"]
    # every format of text has a sample here, which `tests/laws` damages
    assert set(titles.values()) == {kind.title for kind in FORMATS[3:]}
    for name, kind in itertools.product(SAMPLES, FORMATS[3:-1]):
        head = (tmp_path / name).read_text()[:8000]
        alone = kind.recognises(tmp_path / name, head)
        assert alone == (kind.title == titles[name])

"""A reader for every kind of file, and names and columns where they belong."""

import numpy as np
import pytest

from tests.kit import FileError, InputError, refuses, torso
from tests.sensors.test_plus_sequence import sequence
from tests.sensors.test_stream_formats import SAMPLES
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.sensors.netcdf_stream import write_netcdf_wrenches
from ttus_opt.sensors.stream_files import raw_recordings, read_poses, read_wrenches
from ttus_opt.sensors.streams import WrenchStream

TIME = np.arange(4.0)
MAP = {"t": "stamp", "px": "x", "fx": "F1", "tx": "M1"}


def wrenches():
    return WrenchStream(TIME, np.outer(TIME, [1.0, 2, 3]), np.outer(TIME, [4.0, 5, 6]))


@pytest.mark.parametrize("suffix", [".nc", ".NC", ".cdf"])
def test_net_cdf_and_tables_say_the_same(tmp_path, suffix):
    own = wrenches()
    write_netcdf_wrenches(own, tmp_path / f"w{suffix}")
    own.save(tmp_path / "w.csv")
    for name in (f"w{suffix}", "w.csv"):
        found = read_wrenches(tmp_path / name)
        np.testing.assert_allclose(found.time, own.time, atol=1e-9)
        np.testing.assert_allclose(found.force, own.force, atol=1e-9)
        np.testing.assert_allclose(found.torque, own.torque, atol=1e-9)


def test_a_sequence_is_read_as_one_whatever_the_case(tmp_path):
    file = sequence(tmp_path / "s.MHA")
    expected = read_poses(file)
    np.testing.assert_array_equal(read_poses(file).position, expected.position)


def test_of_a_map_for_both_each_stream_takes_its_own(tmp_path):
    """Names of the other's columns, which this file has not, do not matter."""
    own = wrenches()
    turns = np.tile(np.eye(3), (4, 1, 1))
    Trajectory(TIME, np.outer(TIME, [1.0, 0, 0]), turns).save(tmp_path / "p.csv")
    own.save(tmp_path / "w.csv")
    for file, old, new in (("p.csv", "px", "x"), ("w.csv", "fx", "F1")):
        text = (tmp_path / file).read_text()
        head, *rest = text.split("\n", 1)
        names = [n if n != old else new for n in head.split(",")]
        names = ["stamp" if n == "t" else "M1" if n == "tx" else n for n in names]
        (tmp_path / file).write_text("\n".join([",".join(names), *rest]))
    poses = read_poses(tmp_path / "p.csv", columns=MAP)
    np.testing.assert_allclose(poses.position[:, 0], TIME)
    found = read_wrenches(tmp_path / "w.csv", columns=MAP)
    np.testing.assert_allclose(found.force, own.force)
    np.testing.assert_allclose(found.torque, own.torque)


def test_names_and_columns_where_there_are_none_are_told(tmp_path):
    file = sequence(tmp_path / "s.mha")
    refuses(InputError, r"s\.mha has no columns", read_poses, file, columns=MAP)
    wrenches().save(tmp_path / "w.csv")
    with pytest.raises(InputError, match=r"w\.csv has no transform or topic /force"):
        read_wrenches(tmp_path / "w.csv", name="/force")
    (tmp_path / "bag").mkdir()
    for read in (read_poses, read_wrenches):
        refuses(InputError, "bag has no columns", read, tmp_path / "bag", columns=MAP)


def test_a_table_of_neither_kind_is_told_by_the_kind_it_is_nearer(tmp_path):
    file = tmp_path / "own.csv"
    for header, lacks in (("t,px,py,pz", "qw, qx, qy, qz"), ("t,fx,fy", "fz")):
        file.write_text(f"{header}\n{','.join('1' for _ in header.split(','))}\n")
        told = refuses(FileError, f"has no column {lacks}: ", raw_recordings, file)
        assert "t,px,py,pz,qw,qx,qy,qz (poses) or t,fx,fy,fz (wrenches)" in told


def test_wrenches_beside_most_of_a_pose_say_what_it_lacks(tmp_path):
    file = tmp_path / "own.csv"
    file.write_text("t,px,pz,qw,qx,qy,qz,fx,fy,fz\n" + "1,0,0,1,0,0,0,1,2,3\n")
    (raw,) = raw_recordings(file)
    assert not raw.has_poses and "no py: no poses" in raw.notes


def test_what_is_no_such_stream_is_told_by_what_it_is(tmp_path):
    torso().save(tmp_path / "surface.nc")
    refuses(
        FileError, "holds a surface or a field", read_poses, tmp_path / "surface.nc"
    )
    refuses(FileError, "a folder without a recording of ROS 2", read_poses, tmp_path)
    ati = SAMPLES["ati.csv"](tmp_path / "ati.csv")
    refuses(FileError, "has wrenches only, no poses", read_poses, ati)

"""``ttus-opt doctor``: whatever a file is, what it holds is said."""

import json
from pathlib import Path

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import small_scene, torso
from tests.probe.test_repair import broken, written
from tests.scan.test_room import person, room
from tests.sensors.test_stream_formats import SAMPLES
from tests.session.recordings import copied
from ttus_opt import example


@pytest.mark.slow
def test_every_kind_of_file(run, tmp_path, files):
    """Recordings of all makers, a cloud, a surface, a depth image, intrinsics."""
    import cv2

    made = [make(tmp_path / name) for name, make in SAMPLES.items()]
    cv2.imwrite(str(tmp_path / "d.png"), np.full((40, 50), 812, np.uint16))
    camera = {"fx": 50, "fy": 50, "ppx": 25, "ppy": 20, "width": 50, "height": 40}
    (tmp_path / "k.json").write_text(json.dumps(camera))
    points = example.path("scan.ply")
    others = [tmp_path / "d.png", tmp_path / "k.json", points, files / "surface.nc"]
    voxmap = tt.Voxmap.from_surface(torso(), shape=(8, 12, 6), r_inner=0.03)
    field = tt.PotentialField(voxmap, np.zeros(voxmap.grid.shape), "trilinear")
    field.save(tmp_path / "f.nc")
    others.append(tmp_path / "f.nc")
    words = " ".join(map(str, [*made, *others]))
    answer = run(f"doctor {words} --picture {tmp_path / 'all.png'}")
    assert answer.status == 0 and not answer.errors
    for said in (
        "Probe: poses, 6 rows over 0.35 s in 2 recordings, 20 Hz",
        "2 of 8 frames are missing: gaps",
        "counts, 1e+06 per N and 1000 per Nmm",
        "frame numbers at 60 Hz",
        "50 x 40 pixels, 100 % with a depth",
        "camera fx 50.00",
        "8,956 points",
        "surface\n    Surface(",
        "f.nc: field\n    PotentialField(",
    ):
        assert said in answer.out
    assert max(map(len, answer.out.splitlines())) <= 80 + len(str(tmp_path))
    assert (tmp_path / "all.png").stat().st_size > 10_000
    told = run(f"doctor {words} --json").told
    assert [Path(f["file"]).name for f in told["files"]][:2] == list(SAMPLES)[:2]
    assert told["files"][0]["streams"][0]["rate_Hz"] == pytest.approx(20)


def test_all_else_that_commands_read(run, tmp_path):
    """Motions, pairs, photos, messages, sessions and paths of weights."""
    import cv2

    motion = np.diag([-1.0, -1.0, 1.0, 1.0])
    motion[:3, 3] = 0.5, 0.25, 2.0
    np.savetxt(tmp_path / "base.txt", motion)
    (tmp_path / "base.json").write_text(json.dumps(motion.tolist()))
    np.save(tmp_path / "base.npy", motion)
    pairs = [[motion.tolist(), motion.tolist()]] * 5
    (tmp_path / "pairs.json").write_text(json.dumps(pairs))
    cv2.imwrite(str(tmp_path / "photo.png"), np.full((40, 50, 3), 8, np.uint8))
    cv2.imwrite(str(tmp_path / "photo.jpg"), np.full((40, 50, 3), 8, np.uint8))
    found = tt.solution_path("eq10", small_scene(), weights={"force": [0.1, 1.0]})
    tt.write_solution_path(found, tmp_path / "path.nc")
    names = "base.txt base.json base.npy pairs.json photo.png photo.jpg path.nc"
    answer = run("doctor " + " ".join(f"{tmp_path / n}" for n in names.split()))
    assert answer.status == 0
    assert answer.out.count("to (0.5000, 0.2500, 2.0000) m, turned by 180.0°") == 3
    for said in ("5 pairs", "2 of 2 points", "photo.jpg: photo\n    50 x 40 pixels"):
        assert said in answer.out


def test_a_session_and_its_message(run, tmp_path):
    pytest.importorskip("pcodec", reason="needs ttus-opt[sensors]")
    recording = copied(tmp_path)
    surface = tmp_path / "surface.nc"
    torso().save(surface)
    message = tmp_path / "surface.msg"
    assert run(f"encode {surface} -o {message}").status == 0
    answer = run(f"doctor {recording} {message}")
    assert answer.status == 0
    assert "recordings: press_fit, sweep_fit" in answer.out
    assert f"message: surface\n    {message.stat().st_size:,} bytes" in answer.out
    message.write_bytes(message.read_bytes()[:-1])
    assert run(f"doctor {message}").status == 2


def test_faults_and_files_that_cannot_be_read(run, tmp_path):
    file = written(tmp_path / "press.csv", broken())
    answer = run(f"doctor {file}")
    assert answer.status == 1
    for said in (
        "fault: line 4: px is nan (and",
        "--repair: dropped 4 rows",
        "split at",
    ):
        assert said in answer.out
    (tmp_path / "photo.trc").write_text("PathFileType\t4\n")
    answer = run(f"doctor {tmp_path / 'photo.trc'} {file} {tmp_path / 'none.csv'}")
    assert answer.status == 2
    assert answer.out.count("cannot be used") == 2
    assert "fault: line 4" in answer.out  # the others are told all the same


@pytest.mark.parametrize(
    ("name", "text", "told"),
    [
        ("scaled.txt", "2 0 0 0\n0 2 0 0\n0 0 2 0\n0 0 0 1\n", "scales by 2"),
        ("sheared.csv", "1,1,0,0\n0,1,0,0\n0,0,1,0\n0,0,0,1\n", "no rigid motion"),
        ("short.txt", "1 0 0 0\n0 1 0 0\n0 0 1 0\n", "got 12 numbers"),
        ("list.json", "[[2,0,0,0],[0,2,0,0],[0,0,2,0],[0,0,0,1]]", "scales by 2"),
    ],
)
def test_a_damaged_motion_is_no_cloud(run, tmp_path, name, text, told):
    (tmp_path / name).write_text(text)
    answer = run(f"doctor {tmp_path / name}")
    assert answer.status == 2 and told in " ".join(answer.out.split())


def test_units_of_a_cloud_and_of_columns(run, tmp_path):
    points = np.random.default_rng(0).uniform(0, 400, (500, 3))
    np.savetxt(tmp_path / "cloud.xyz", points)
    assert "likely in mm: --unit mm" in run(f"doctor {tmp_path / 'cloud.xyz'}").out
    rows = broken()[:1] + [[0.05 * i, 100.0 + i, 0, 0, 1, 0, 0, 0] for i in range(1, 9)]
    file = written(tmp_path / "mm.csv", rows)
    assert "likely in mm: px=NAME[mm]" in " ".join(run(f"doctor {file}").out.split())
    told = run(f"doctor {file} --columns px=px[mm],py=py[mm],pz=pz[mm]")
    assert told.status == 0 and "units?" not in told.out


def test_several_bodies_in_a_room_are_named_in_its_own_unit(run, tmp_path):
    np.save(tmp_path / "two.npy", 1.2 * np.r_[room(), person(-0.6), person(0.6)])
    told = run(f"doctor {tmp_path / 'two.npy'}")
    assert told.status == 2
    told = " ".join(told.out.split())
    assert "several bodies: crop it by --box" in told
    box = told.split("--box ")[1].split(";")[0]
    assert run(f"doctor {tmp_path / 'two.npy'} --box {box}").status == 0


def test_one_stream_of_several(run, tmp_path):
    """Of poses and of depth images; a name that a file has not is told with those."""
    file = SAMPLES["toolbox.csv"](tmp_path / "toolbox.csv")
    answer = run(f"doctor {file} --stream Stylus")
    assert "Stylus: poses, 8 rows" in answer.out
    assert "Probe" not in answer.out
    answer = run(f"doctor {file} --stream Hand")
    assert answer.status == 2
    assert "has no tool Hand, but Probe, Stylus" in " ".join(answer.out.split())
    pytest.importorskip("rosbags", reason="needs ttus-opt[sensors]")
    from tests.sensors.test_depth_bag import ALIGNED, recorded

    bag = recorded(tmp_path / "two.bag", aligned=True)
    both = run(f"doctor {bag}").out
    one = run(f"doctor {bag} --stream {ALIGNED}/image_raw").out
    for said, times in (("32 x 24 pixels", 1), ("image 3 of 5", 2), ("fx 30.00", 1)):
        assert both.count(said) == times
    assert "fx 30.00" in one and "32 x 24" not in one

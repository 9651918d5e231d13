"""Values of a description by kind: each key's sound ones, and the line on others."""

import json
import math

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, refuses
from ttus_opt.session.section import Section

TURN = Rotation.from_rotvec([0.1, -0.4, 0.2])


def section(folder, **values):
    return Section(folder / "session.yaml", "tracker", values)


def motion():
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = TURN.as_matrix(), [0.1, 0.2, -0.3]
    return out


def test_a_motion_may_be_said_in_three_ways(tmp_path):
    numbers = [0.1, 0.2, -0.3, *TURN.as_quat()]
    (tmp_path / "m.json").write_text(json.dumps(motion().tolist()))
    told = section(
        tmp_path,
        rows=motion().tolist(),
        list=numbers,
        text=",".join(map(str, numbers)),
        file="m.json",
    )
    for key in told.values:
        np.testing.assert_allclose(told.motion(key), motion(), atol=1e-12)
    both = section(tmp_path, all=[numbers, motion().tolist()]).motions("all")
    np.testing.assert_allclose(both, [motion(), motion()], atol=1e-12)


@pytest.mark.parametrize(
    "value",
    [
        [1, 2, 3],
        [[1, 2], [3]],
        np.diag([2.0, 2.0, 2.0, 1.0]).tolist(),
        np.diag([1.0, 1.0, -1.0, 1.0]).tolist(),
        ["a"] * 7,
        "nowhere.json",
        {"x": 1},
        3.5,
        [0, 0, 0, 0, 0, 0, 0],
    ],
)
def test_what_is_no_motion_is_told_with_its_place(tmp_path, value):
    told = refuses(FileError, "", section(tmp_path, to_scan=value).motion, "to_scan")
    assert "to_scan" in told or "nowhere" in told


@pytest.mark.parametrize("value", [True, "wide", None, math.nan, math.inf, [1], {}])
def test_what_is_no_number_is_told(tmp_path, value):
    with pytest.raises(FileError, match=r"session\.yaml: tracker\.n (must|is missing)"):
        section(tmp_path, n=value).number("n")


def test_numbers_as_texts_and_defaults(tmp_path):
    told = section(tmp_path, n="1e-2", many=[1, "2", 3.5], whole=[3.0, 4], none=None)
    assert told.number("n") == 0.01
    assert told.numbers("many", 3) == (1.0, 2.0, 3.5)
    assert told.whole("whole", 2) == (3, 4)
    assert told.number("none", 7.0) == 7.0 == told.number("absent", 7.0)
    assert told.numbers("absent", 2, [1.0, 2.0]) == (1.0, 2.0)
    for call in (
        lambda: told.numbers("many", 2),
        lambda: told.numbers("n", 1),
        lambda: told.whole("many", 3),
    ):
        refuses(FileError, "must be", call)


def test_texts_choices_and_flags(tmp_path):
    told = section(tmp_path, by="ear", empty="", on=True, odd="yes")
    assert told.text("by") == "ear" and told.text("absent", "x") == "x"
    assert told.choice("by", ["ear", "eye"]) == "ear"
    with pytest.raises(FileError, match="must be eye or nose, got 'ear'"):
        told.choice("by", ["eye", "nose"])
    refuses(FileError, "must be a text", told.text, "empty")
    assert told.flag("on") and not told.flag("absent")
    refuses(FileError, "must be true or false, got 'yes'", told.flag, "odd")


def test_files_are_beside_the_description(tmp_path):
    (tmp_path / "a.csv").touch()
    told = section(tmp_path, file="a.csv", both=["a.csv", "a.csv"], gone=["b.csv"])
    assert told.path("file") == tmp_path / "a.csv"
    assert told.paths("file") == (tmp_path / "a.csv",)
    assert told.paths("both") == (tmp_path / "a.csv",) * 2
    refuses(FileError, r"is b\.csv, which is not in", told.paths, "gone")
    refuses(FileError, "not in", section(tmp_path, file="a\0b").path, "file")
    with pytest.raises(FileError, match="a file or a list of files"):
        section(tmp_path, file=[]).paths("file")


def test_unknown_keys_and_sections_within(tmp_path):
    told = section(tmp_path, sensor={"axes": 1}, flat=3, odd={1: 2})
    with pytest.raises(FileError, match="flat is not known: choose from sensor, odd"):
        told.require_known(["sensor", "odd"])
    with pytest.raises(FileError, match="flat is not known: did you mean float"):
        told.require_known(["sensor", "odd", "float"])
    inner = told.section("sensor")
    assert (inner.place, inner.get("axes")) == ("tracker.sensor", 1)
    assert not told.section("absent").values
    refuses(FileError, r"tracker\.flat must map names to values", told.section, "flat")
    refuses(FileError, "has 1 for a name: put it in quotes", told.section, "odd")
    assert "axes" in inner and "absent" not in inner
    refuses(FileError, r"tracker\.sensor\.mass is missing: add it", inner.get, "mass")

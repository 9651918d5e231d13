"""Mappings as YAML, JSON and OpenCV write them, and one line on the rest."""

import json

import pytest

from tests.kit import FileError, refuses
from ttus_opt.sensors.mapping_file import LARGEST_FILE, read_mapping

pytest.importorskip("yaml", reason="needs ttus-opt[sensors]")

CONTENT = {"a": 1, "b": {"c": [1.5, "x", None, True]}}
OPENCV = """%YAML:1.0
---
K: !!opencv-matrix
   rows: 1
   cols: 2
   dt: d
   data: [ 1.5, 2. ]
"""


def test_yaml_and_json_say_the_same(tmp_path):
    (tmp_path / "a.json").write_text(json.dumps(CONTENT))
    (tmp_path / "a.yaml").write_text("a: 1\nb:\n  c: [1.5, x, null, true]\n")
    (tmp_path / "json.yaml").write_text("\n " + json.dumps(CONTENT))
    (tmp_path / "mark.json").write_text("\ufeff" + json.dumps(CONTENT), "utf-8")
    for name in ("a.json", "a.yaml", "json.yaml", "mark.json"):
        assert read_mapping(tmp_path / name, "session") == CONTENT


def test_matrices_of_opencv_are_mappings(tmp_path):
    (tmp_path / "k.yml").write_text(OPENCV)
    found = read_mapping(tmp_path / "k.yml", "camera")["K"]
    assert found == {"rows": 1, "cols": 2, "dt": "d", "data": [1.5, 2.0]}
    # the line that is told is the file's own
    (tmp_path / "k.yml").write_text(OPENCV + "a: b: c\n")
    refuses(FileError, r"\(line 8\)", read_mapping, tmp_path / "k.yml", "camera")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("[1, 2]", "is not a session: it must map names to values"),
        ("1: a", "it must map names to values"),
        ("a: 'b", r"cannot be read as XML, YAML or JSON \(line 1\)"),
        ('{"a": ', r"cannot be read as XML, YAML or JSON \(line 1\)"),
        ("a: !!python/object/apply:os.system ['true']", "cannot be read as XML, YAML"),
        ("", r"session file .* is empty"),
    ],
)
def test_what_is_no_mapping_is_told(tmp_path, text, told):
    (tmp_path / "s.yaml").write_text(text)
    refuses(FileError, told, read_mapping, tmp_path / "s.yaml", "session")


def test_large_and_missing_files_are_refused(tmp_path):
    refuses(FileError, "not found", read_mapping, tmp_path / "s.yaml", "session")
    (tmp_path / "s.yaml").write_text("a: " + "x" * LARGEST_FILE)
    refuses(FileError, "", read_mapping, tmp_path / "s.yaml", "session")

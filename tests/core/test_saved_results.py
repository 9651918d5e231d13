"""Values as JSON knows them."""

import numpy as np
import pytest

from ttus_opt.core.errors import FileError
from ttus_opt.core.saved_results import append_line, computed_once, plain, read_lines


def test_what_json_does_not_know_is_none_and_all_else_stays():
    given = {
        1: [np.nan, np.inf, -0.5, "a word", None, True],
        "in": {"to": (np.int64(3), np.array([1.0, -np.inf]))},
    }
    assert plain(given) == {
        "1": [None, None, -0.5, "a word", None, True],
        "in": {"to": [3, [1.0, None]]},
    }


def result(file, value, **inputs):
    """Value of a result: what was computed, or what is in the file."""
    return computed_once(
        file,
        inputs,
        lambda: value,
        save=lambda value: {"value": value},
        load=lambda content: content["value"],
    )


def test_a_result_of_the_same_inputs_is_not_computed_again(tmp_path):
    file = tmp_path / "eq10.json"
    assert result(file, 1.0, weight=0.5, shape=(8, 16, 8)) == 1.0
    assert result(file, 2.0, weight=0.5, shape=(8, 16, 8)) == 1.0
    assert result(file, 3.0, weight=0.6, shape=(8, 16, 8)) == 3.0
    assert result(file, 4.0, weight=0.6) == 3.0
    assert result(file, float("nan"), weight=0.7) != 0.0
    assert result(file, 5.0, weight=0.7) is None  # NaN is null in a file


@pytest.mark.parametrize(
    "content",
    [b"", b"{", b"null", b"[1]", b"\xff\xfe\x00", 100_000 * b"[", b'{"weight": 1.0}'],
)
def test_a_damaged_result_is_computed_again(tmp_path, content):
    file = tmp_path / "eq10.json"
    file.write_bytes(content)
    assert result(file, 2.0, weight=1.0) == 2.0
    assert result(file, 3.0, weight=1.0) == 2.0


def test_a_result_whose_other_file_is_lost_is_computed_again(tmp_path):
    def load(content):
        raise FileError("field.nc not found")

    file = tmp_path / "eq10.json"
    result(file, 1.0)
    found = computed_once(file, {}, lambda: 2.0, save=lambda v: {"value": v}, load=load)
    assert found == 2.0
    assert result(file, 3.0) == 2.0


def test_lines_before_and_after_a_truncated_one_are_read(tmp_path):
    file = tmp_path / "new" / "rows.jsonl"
    assert read_lines(file) == []
    append_line(file, [{"key": "a"}])
    with file.open("a") as opened:
        opened.write('[{"ke\n')
    append_line(file, 2)
    assert read_lines(file) == [[{"key": "a"}], 2]

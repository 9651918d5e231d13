"""The documentation's tables of the shelf, and its rows that are measured."""

import json
import math
from pathlib import Path

import pytest

from benchmarks import performance_rows, shelf_tables
from tests.benchmark.rows import failed, row
from tests.kit import refuses

ROOT = Path(__file__).resolve().parents[2]


def answer(formulation, seconds, **other):
    solver = other.pop("solver", "auto")
    told = {"formulation": formulation, "cpu_first": seconds, "taken": "structured"}
    return row(solver, 99.0, 1.0, **told, **other)


ROWS = [
    answer("eq10", 0.1),
    answer("eq10", 1.0, case="M", voxels=518_400),
    answer("tikhonov", 0.2),
    answer("tikhonov", 2.0, solver="scs"),
    answer("tikhonov", 6.0, case="M", voxels=518_400),
    answer("tikhonov", 41.0, case="L", voxels=1_080_000),
    answer("robust", 20.0, case="M", voxels=518_400),
    failed("auto") | {"formulation": "total_variation", "case": "M"},
]


def test_ratios_growth_and_failures_by_hand():
    lines = {
        line.split("|")[1].strip(): [cell.strip() for cell in line.split("|")[2:-1]]
        for line in shelf_tables.shelf_table(ROWS).splitlines()[2:]
    }
    assert list(lines) == ["eq10", "tikhonov", "robust", "total_variation"]
    assert lines["eq10"][:5] == ["structured", "0.1", "1 ×", "1", "1 ×"]
    assert lines["eq10"][7] == "1.00"  # ten times the voxels, ten times the time
    assert lines["tikhonov"][1:6] == ["0.2", "2 ×", "6", "6 ×", "41"]
    assert lines["total_variation"][3] == "(time limit)"
    assert math.isnan(shelf_tables.growth(ROWS[:1]))


def test_late_by_the_clock_of_a_busy_machine_is_not_late():
    late = answer("eq10", 30.0, status="time limit", detail="solved after 184 s")
    assert shelf_tables.solved(late)  # its limit is 100 s
    assert not shelf_tables.solved(late | {"cpu_first": 101.0})
    assert not shelf_tables.solved(late | {"detail": "MaxTime"})
    (told,) = shelf_tables.profile_rows([late | {"solver": "scs"}])
    assert (told["status"], told["seconds_first"]) == ("solved", 30.0)


def test_missed_goals_are_told_and_met_ones_are_not():
    told = shelf_tables.missed(ROWS)
    assert [line.split(":")[0].split(" (")[0] for line in told] == [
        "`tikhonov` on M",
        "`total_variation` on M",
        "`tikhonov` on L",
        "`tikhonov` grows like V^1.69",
        "`tikhonov` on S",
    ]
    assert told[-1].endswith("10 × faster than the best general solver (goal 20 ×)")


def test_a_folder_is_read_once_and_markers_are_filled(tmp_path):
    text = "".join(json.dumps([each]) + "\n" for each in (*ROWS, ROWS[0]))
    (tmp_path / "rows.jsonl").write_text(text, encoding="utf-8")
    keys = {each["key"] for each in ROWS}
    assert sorted(
        each["key"] for each in shelf_tables.read([tmp_path, tmp_path])
    ) == sorted(keys)
    by_clock = shelf_tables.read([tmp_path], wall=True)
    assert {each["cpu_first"] for each in by_clock if each["status"] == "solved"} == {
        99.0
    }
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- a: begin -->\nold\n<!-- a: end -->\nafter\n")
    for _ in range(2):  # filling in again changes nothing
        shelf_tables.filled(page, "a", "new")
        assert page.read_text() == (
            "before\n<!-- a: begin -->\n\nnew\n\n<!-- a: end -->\nafter\n"
        )
    refuses(ValueError, "markers", shelf_tables.filled, page, "b", "new")


def test_the_markers_are_in_the_pages():
    for page, names in (
        (ROOT / "docs" / "benchmark.md", "shelf general profile perturbed missed"),
    ):
        text = page.read_text(encoding="utf-8")
        for name in names.split():
            assert text.count(f"<!-- {name}: begin -->") == 1, (page, name)
            assert text.count(f"<!-- {name}: end -->") == 1, (page, name)


def test_every_row_of_the_page_is_measured():
    assert [
        performance_rows.begins(row) for row in performance_rows.told_rows()
    ] == list(performance_rows.ROWS)
    refuses(KeyError, "put it into ROWS", performance_rows.begins, "a new row")


def test_a_later_folders_ratio_is_to_its_own_eq10(tmp_path):
    earlier = [answer("eq10", 0.1), answer("tikhonov", 0.3)]
    later = [answer("eq10", 0.2), answer("tikhonov", 0.4)]
    for name, rows in (("a", earlier), ("b", later)):
        (tmp_path / name).mkdir()
        told = [row | {"key": f"{name} {n}"} for n, row in enumerate(rows)]
        (tmp_path / name / "rows.jsonl").write_text(json.dumps(told) + "\n")
    found = shelf_tables.read([tmp_path / "a", tmp_path / "b"])
    own = shelf_tables.by(found, "S")
    assert own["eq10"]["cpu_first"] == 0.1
    assert own["tikhonov"]["cpu_first"] == 0.4
    assert shelf_tables.times(own["tikhonov"], own["eq10"]) == pytest.approx(2.0)

"""Runs of parts in their own processes: figures, failures, going on after a stop."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from ttus_opt.benchmark.cases import CaseSpec, reference_cases
from ttus_opt.benchmark.page import write_page
from ttus_opt.benchmark.parts import suite
from ttus_opt.benchmark.parts.base import Figures, PartSpec
from ttus_opt.benchmark.parts.registry import SOLVERS, chosen, parts
from ttus_opt.benchmark.parts.suite import PartSuite
from ttus_opt.cli import main
from ttus_opt.errors import InputError

TINY = replace(reference_cases("S")[0], name="tiny", shape=(9, 20, 9), n_poses=10)


def small_suite(folder: Path, cases: Sequence[CaseSpec] = (TINY,)) -> PartSuite:
    return PartSuite(["assembly"], cases, folder, time_limit=60.0)


@pytest.mark.slow
def test_runs_once_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = small_suite(tmp_path)
    rows = asked.run()
    assert set(rows) == set(parts())
    assert [row["status"] for row in rows["assembly"]] == ["measured"] * 3
    assert all(row["peak_memory_bytes"] > 2**26 for row in rows["assembly"])
    assert rows["assembly"][0]["memory_by_stage"]["L, b"] > 2**26
    assert not rows["ripple"]

    def never(spec: PartSpec, limit: int | None) -> list[Figures]:
        raise AssertionError("a run that is there was run again")

    monkeypatch.setattr(suite, "run_part", never)
    # cut off in the middle of a line, as an interruption may leave it
    with asked.rows_file.open("a") as file:
        file.write('[{"key": "assembly')
    assert asked.run() == rows


def test_failures_are_rows(tmp_path: Path) -> None:
    gone = replace(TINY, name="gone", surface=str(tmp_path / "no.nc"))
    (row,) = small_suite(tmp_path, [gone]).run()["assembly"]
    assert row["status"] == "refused"
    assert "no.nc" in row["detail"]
    assert row["peak_memory_bytes"] > 2**26
    (row,) = replace(small_suite(tmp_path), memory_limit=2**20).run()["assembly"]
    assert row["status"] == "memory limit"
    assert "memory limit: ended during" in parts()["assembly"].table([row])


@pytest.mark.slow
def test_failures_say_which_run_they_are(tmp_path: Path) -> None:
    gone = replace(TINY, name="gone", surface=str(tmp_path / "no.nc"))
    rows = PartSuite(["rendering"], [gone], tmp_path).run()["rendering"]
    assert [row["sampling"] for row in rows] == ["voxel-mean", "trilinear"]


def test_names() -> None:
    named = ["assembly", "profile", "recursion", "rendering", "ripple"]
    assert chosen("all") == [SOLVERS, *named]
    assert chosen("ripple, solvers,ripple") == ["ripple", SOLVERS]
    for text in ("riple", "", "solvers,all"):
        with pytest.raises(InputError, match="choose from solvers, assembly"):
            chosen(text)


def test_page_of_parts_alone(tmp_path: Path) -> None:
    row = {"case": "S", "status": "time limit", "detail": "ended during updates"}
    page = write_page(
        tmp_path,
        [],
        closed_form="closed_form",
        command="ttus-opt benchmark",
        machine={"cores": "2"},
        parts={"recursion": [row], "ripple": []},
    )
    text = page.read_text("utf-8")
    headings = [line for line in text.splitlines() if line.startswith("## ")]
    assert headings == ["## One measurement at a time", "## Machine"]
    assert "time limit: ended during updates" in text


def test_command_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def quick(spec: PartSpec, limit: int | None) -> list[Figures]:
        row = {"key": spec.key, "case": spec.case_name, "status": "crashed"}
        return [{**row, "detail": ""}]

    monkeypatch.setattr(suite, "run_part", quick)
    with pytest.raises(SystemExit) as ended:
        main(
            ["benchmark", "--parts", "ripple,rendering", "-o", str(tmp_path), "--json"]
        )
    assert ended.value.code == 0
    told = json.loads(capsys.readouterr().out)
    assert told["rows"] == told["recursion"] == told["assembly"] == []
    assert len(told["rendering"]) == 2
    assert len(told["ripple"]) == 3
    assert "## Ripple" in Path(told["report"]).read_text("utf-8")
    with pytest.raises(SystemExit) as ended:
        main(["benchmark", "--parts", "riple", "-o", str(tmp_path / "out")])
    assert ended.value.code == 2
    assert "unknown part 'riple'" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()

"""The report and the CSV files beside the rows."""

import csv

import pytest

from tests.benchmark.rows import failed, row
from ttus_opt.benchmark.report import write_report
from ttus_opt.benchmark.row import Settings

ROWS = [
    row("closed_form", 10.0, 8.0),
    row("other", 1.0, 8.0),
    row("other", 3.0, 8.0, case="M", voxels=300_000),
    failed("slow"),
]


def written(folder, found, **settings):
    path = write_report(
        folder,
        found,
        Settings(**settings),
        command="ttus-opt benchmark",
        machine={"cores": "2"},
    )
    return path.read_text("utf-8")


def headings(text):
    return [line for line in text.splitlines() if line.startswith("## ")]


@pytest.mark.slow
def test_report_has_the_closed_form_first_and_pictures(tmp_path):
    text = written(tmp_path, {"solvers": ROWS}, memory=True)
    assert headings(text)[0] == "## Against the closed form Q p = d"
    assert "## Memory by stage [MiB]" in headings(text)
    assert headings(text)[-1] == "## Machine"
    assert "| eq10        | other  | S to M (2) | time ∝ V^0.63 |" in text
    for picture in (
        "time-eq10.png",
        "memory-eq10.png",
        "residual-eq10.png",
        "profile.png",
    ):
        assert picture in text
        assert (tmp_path / picture).stat().st_size > 2_000


def test_report_of_failures_alone(tmp_path):
    for status in ("refused", "time limit"):
        text = written(tmp_path, {"solvers": [failed("slow", status)]})
        assert "`closed_form` has no answer here" in text


def test_report_of_other_parts_alone(tmp_path):
    lost = {"case": "S", "status": "time limit", "detail": "ended during updates"}
    text = written(tmp_path, {"solvers": [], "recursion": [lost], "ripple": []})
    assert headings(text) == ["## One measurement at a time", "## Machine"]
    assert "time limit: ended during updates" in text


@pytest.mark.slow
def test_rows_are_there_as_csv(tmp_path):
    written(tmp_path, {"solvers": ROWS})
    with (tmp_path / "solvers.csv").open(newline="") as file:
        told = list(csv.DictReader(file))
    assert [line["solver"] for line in told] == [
        "closed_form",
        "other",
        "other",
        "slow",
    ]
    assert float(told[1]["seconds_first"]) == 1.0
    assert float(told[0]["kkt.dual_relative"]) == 2e-8
    assert told[3]["seconds_first"] == told[3]["kkt.dual_relative"] == ""

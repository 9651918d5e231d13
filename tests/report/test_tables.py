import numpy as np

from tests.kit import refuses
from ttus_opt.report.document import Table, text
from ttus_opt.report.metrics import Errors, Evaluation
from ttus_opt.report.tables import Comparison, error_section, error_table

NAN = float("nan")


def evaluation(magnitude, angle=3.0):
    errors = Errors(
        magnitude, 2 * magnitude, 0.0, angle, 0.004, 0.005, NAN, 40, 30, 0, 0.5, 0.01
    )
    zero = np.zeros((40, 3))
    return Evaluation(
        errors, np.arange(40.0), zero, zero, zero, zero, np.ones(40, bool), zero[:, 0]
    )


COMPARISONS = [
    Comparison("press_fit", True, evaluation(0.4), evaluation(0.2)),
    Comparison("press_test", False, evaluation(0.5), evaluation(0.25)),
]


def cells(line):
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_table_columns_are_aligned_and_complete():
    lines = str(Table(["name", "n"], [["a", "1"], ["longer", "22"]])).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert [cells(line) for line in lines[2:]] == [["a", "1"], ["longer", "22"]]


def test_table_refuses_rows_of_another_length():
    refuses(ValueError, "zip", str, Table(["a", "b"], [["1", "2", "3"]]))


def test_error_table_shows_before_and_after_in_the_stated_units():
    lines = str(error_table(COMPARISONS)).splitlines()
    header, first, second = cells(lines[0]), cells(lines[2]), cells(lines[3])
    assert first[0] == "press_fit (same)" and second[0] == "press_test (new)"
    assert first[1] == "30/40"
    assert first[header.index("force [N]")] == "0.40 → 0.20"
    assert first[header.index("rmse [N]")] == "0.80 → 0.40"
    assert first[header.index("torque [mN m]")] == "4.0 → 4.0"
    assert first[-1] == "– → –"  # no torque direction: NaN is never printed


def test_the_section_has_the_table_and_the_threshold():
    said = text(error_section(COMPARISONS))
    assert str(error_table(COMPARISONS)) in said
    assert "force above 0.5 N" in said

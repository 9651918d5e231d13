"""Means, exponents and tables over rows, by hand."""

import pytest

from tests.benchmark.rows import failed, row
from ttus_opt.benchmark import summary


def test_shifted_geometric_mean_by_hand():
    assert summary.shifted_geometric_mean([3.0, 8.0], shift=1.0) == pytest.approx(5.0)
    assert summary.shifted_geometric_mean([7.0], shift=10.0) == pytest.approx(7.0)


def test_failures_count_as_the_time_limit_and_refusals_do_not():
    rows = [
        row("fast", 1.0, 5.0),
        failed("slow"),
        failed("unable", "refused"),
        failed("absent", "not installed"),
        row("slow", 3.0, 5.0, case="M"),
    ]
    fast, slow = summary.scores(rows)
    assert (fast["solver"], fast["solved"], fast["run"]) == ("fast", 1, 1)
    assert fast["again"] == pytest.approx(0.1)
    assert (slow["solver"], slow["solved"], slow["run"]) == ("slow", 1, 2)
    assert slow["first"] == pytest.approx((101.0 * 4.0) ** 0.5 - 1.0)


def test_the_worst_residual_is_a_relative_one():
    assert summary.worst_relative(row("a", 1.0, 1.0)) == 2e-8
    assert summary.worst_relative(failed("b")) is None


def test_tables_say_ratios_and_reasons():
    rows = [
        row("closed_form", 10.0, 8.0, difference_from_closed_form=0.0),
        row("other", 1.0, 8.0, difference_from_closed_form=3e-7),
        failed("slow"),
    ]
    against = str(summary.closed_form_table(rows, "closed_form"))
    assert "reference" in against
    assert "3.0e-07" in against
    assert "× 0.1" in against
    assert "slow" not in against
    assert "time limit: ended during first" in str(summary.row_table(rows))
    assert "256" in str(summary.memory_table(rows))
    assert not summary.closed_form_table(rows, "closed_form_pardiso")
    assert summary.ratio(1.0, None) == "–"


def test_table_tells_active_limits():
    table = summary.row_table([row("a", 1.0, 1.0, active_limits=37), failed("b")])
    lines = str(table).splitlines()
    assert lines[0].rstrip("| ").endswith("active limits")
    assert lines[2].rstrip("| ").endswith("37")
    assert lines[3].rstrip("| ").endswith("–")


def test_growth_is_the_slope_of_verified_answers():
    def sized(solver, case, voxels, seconds):
        return row(solver, seconds, 1.0, case=case, voxels=voxels)

    rows = [
        sized("cube", "L", 100_000, 8.0e3),
        sized("cube", "S", 1_000, 8.0e-3),
        sized("cube", "M", 10_000, 8.0),
        sized("cube", "XL", 10**6, 1.0) | {"status": "inaccurate"},
        sized("flat", "S", 1_000, 2.0),
        sized("flat", "M", 10_000, 2.0) | {"seconds_again": None},
        sized("alone", "S", 1_000, 2.0),
    ]
    *_, flat, cube = str(summary.growth_table(rows)).splitlines()
    cells = [cell.strip() for cell in cube.strip("|").split("|")]
    cubic = "time ∝ V^3.00"
    assert cells == ["eq10", "cube", "S to L (3)", cubic, cubic]
    cells = [cell.strip() for cell in flat.strip("|").split("|")]
    assert cells[1] == "flat"
    assert cells[3].strip("-") in ("time ∝ V^0.00", "time ∝ V^-0.00")
    assert cells[4] == "–"
    assert not summary.growth_table(rows[-1:])

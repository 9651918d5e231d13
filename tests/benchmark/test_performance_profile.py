"""Performance profiles against ratios by hand."""

import math

import numpy as np
import pytest

from tests.benchmark.rows import failed, row
from ttus_opt.benchmark.performance_profile import (
    profile_picture,
    profile_table,
    ranked,
    ratios,
    share,
)

#: Three problems: a is fastest twice; b four times slower, then fastest, then fails
ROWS = [
    row("a", 1.0, 1.0),
    row("b", 4.0, 1.0),
    row("a", 6.0, 1.0, case="M"),
    row("b", 2.0, 1.0, case="M"),
    row("a", 5.0, 1.0, formulation="robust"),
    failed("b") | {"formulation": "robust"},
    failed("a") | {"case": "L"},  # solved by nobody: no problem of the profile
    failed("b", "refused") | {"case": "L"},
    failed("never"),
]


def test_ratios_by_hand():
    found = ratios(ROWS)
    assert found["a"] == pytest.approx([1.0, 3.0, 1.0])
    assert found["b"] == pytest.approx([4.0, 1.0, math.inf])
    assert found["never"] == [math.inf] * 3
    assert [share(found["b"], f) for f in (1.0, 3.9, 4.0, 1e9)] == pytest.approx(
        [1 / 3, 1 / 3, 2 / 3, 2 / 3]
    )
    assert math.isnan(share([], 2.0))


def test_the_table_ranks_who_is_near_the_best():
    found = ranked(ROWS)
    assert list(found) == ["a", "b"]
    lines = str(profile_table(found)).splitlines()
    assert [cell.strip() for cell in lines[0].split("|")[2:4]] == ["τ = 1", "τ = 2"]
    assert lines[2].split("|")[2].strip() == "67%"
    assert lines[3].split("|")[-2].strip() == "67%"


def test_the_picture_has_the_steps():
    axes = profile_picture(ranked(ROWS)).axes[0]
    steps = {line.get_label(): line for line in axes.lines}
    tau, height = (np.asarray(v) for v in steps["b"].get_data())
    at = [height[np.flatnonzero(tau <= f)[-1]] for f in (1.0, 2.0, 4.0, tau[-1])]
    assert at == pytest.approx([1 / 3, 1 / 3, 2 / 3, 2 / 3])
    assert axes.get_xscale() == "log"

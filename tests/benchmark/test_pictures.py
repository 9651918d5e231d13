"""Pictures of a run: every mark is a row's, failures stand at the time limit."""

import math

import matplotlib.image
import numpy as np
import pytest

from tests.benchmark.rows import failed, row
from ttus_opt.benchmark import pictures
from ttus_opt.benchmark.summary import MIB, NOT_RUN


def rows():
    small, large = row("one", 2.0, 1.0), row("one", 30.0, 1.0)
    return [
        large | {"voxels": 5000},
        small | {"voxels": 1000},
        row("two", 7.0, 1.0) | {"voxels": 1000},
        failed("two") | {"voxels": 5000, "kkt": None, "peak_memory_bytes": None},
    ]


def test_solvers_are_told_apart_without_colour():
    names = [f"s{i:02d}" for i in range(len(pictures.INKS) * len(pictures.MARKERS))]
    styles = pictures.solver_styles([*names, *names])
    assert list(styles) == names
    told = {(s["marker"], s["linestyle"]) for s in styles.values()}
    assert len(told) > 0.9 * len(names)
    assert pictures.solver_styles(reversed(names)) == styles


def test_curves_are_the_rows_and_failures_are_unfilled():
    given = sorted(rows(), key=lambda each: (each["voxels"], each["solver"]))
    inks = pictures.solver_styles(["one", "two"])
    drawn = {name: figure for name, _, figure in pictures._pictures(given, inks)}
    assert list(drawn) == ["time", "memory", "residual"]
    lines = drawn["time"].axes[0].lines
    one, no_failures, two, failures = lines[:4]
    np.testing.assert_allclose(one.get_xdata(), [1000, 5000])
    np.testing.assert_allclose(one.get_ydata(), [2.0, 30.0])
    assert not len(no_failures.get_xdata())
    np.testing.assert_allclose(two.get_ydata(), [7.0])
    # aside by a little, as all that fail share the time limit
    np.testing.assert_allclose(failures.get_xdata(), [5000 * 1.04])
    np.testing.assert_allclose(failures.get_ydata(), [100.0])
    assert failures.get_fillstyle() == "none" and one.get_fillstyle() == "full"
    memory = drawn["memory"].axes[0].lines
    np.testing.assert_allclose(memory[0].get_ydata(), [2**28 / MIB] * 2)
    assert not len(memory[3].get_xdata())  # a failure without a figure


@pytest.mark.slow
def test_a_picture_is_saved_for_each_formulation(tmp_path):
    other = [each | {"formulation": "robust", "kkt": None} for each in rows()[:2]]
    never = failed("three", NOT_RUN[0]) | {"voxels": 1000, "formulation": "gone"}
    drawn = pictures.pictures([*rows(), *other, never])
    expected = ["time", "memory", "residual"]
    assert [picture.path for picture in drawn] == [
        *(f"{name}-eq10.png" for name in expected),
        *(f"{name}-robust.png" for name in expected[:2]),
    ]
    for picture in drawn:
        file = picture.path
        assert picture.caption.startswith(file.split("-")[1].removesuffix(".png"))
        picture.save(tmp_path)
        assert matplotlib.image.imread(tmp_path / file).std() > 0.0


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
    found = pictures.ratios(ROWS)
    assert found["a"] == pytest.approx([1.0, 3.0, 1.0])
    assert found["b"] == pytest.approx([4.0, 1.0, math.inf])
    assert found["never"] == [math.inf] * 3
    assert [
        pictures.share(found["b"], f) for f in (1.0, 3.9, 4.0, 1e9)
    ] == pytest.approx([1 / 3, 1 / 3, 2 / 3, 2 / 3])
    assert math.isnan(pictures.share([], 2.0))


def test_the_table_ranks_who_is_near_the_best():
    found = pictures.ranked(ROWS)
    assert list(found) == ["a", "b"]
    lines = str(pictures.profile_table(found)).splitlines()
    assert [cell.strip() for cell in lines[0].split("|")[2:4]] == ["τ = 1", "τ = 2"]
    assert lines[2].split("|")[2].strip() == "67%"
    assert lines[3].split("|")[-2].strip() == "67%"


def test_the_picture_has_the_steps():
    axes = pictures.profile_picture(pictures.ranked(ROWS)).axes[0]
    steps = {line.get_label(): line for line in axes.lines}
    tau, height = (np.asarray(v) for v in steps["b"].get_data())
    at = [height[np.flatnonzero(tau <= f)[-1]] for f in (1.0, 2.0, 4.0, tau[-1])]
    assert at == pytest.approx([1 / 3, 1 / 3, 2 / 3, 2 / 3])
    assert axes.get_xscale() == "log"

"""Which tables a benchmark of solvers shows, by how many problems it has."""

import pytest

from tests.benchmark.rows import row
from ttus_opt.benchmark.parts.solvers import FEWEST, MANY, PART
from ttus_opt.benchmark.row import Settings
from ttus_opt.report.document import Picture, text

QUIET = Settings(closed_form="")


def problems(count):
    """Two solvers on each, the second twice as slow."""
    rows = []
    for k in range(count):
        case = {"case": f"C{k}", "voxels": 1000 * (k + 1)}
        rows.append(row("swift", 1.0, 2.0, **case))
        rows.append(row("steady", 2.0, 2.0, **case))
    return rows


@pytest.mark.parametrize("count", [1, FEWEST, MANY, MANY + 1])
def test_the_terminal_has_a_table_for_each_of_few_problems(count):
    """And a line for each of many; a profile from two of them on."""
    said = text(PART.text(problems(count), QUIET))
    each = [f"C{k}, eq10, {1000 * (k + 1):,} voxels:" in said for k in range(count)]
    assert all(each) if count <= MANY else not any(each)
    assert ("Solved of those run, and the fastest:" in said) == (count > MANY)
    profiled = f"Share of {count} problems solved within τ times the fastest" in said
    assert profiled == (count >= FEWEST)
    assert "Memory by stage" not in said
    told = text(PART.text(problems(count), Settings(closed_form="", memory=True)))
    assert "Memory by stage" in told
    assert "Against the closed form" not in said


def test_the_reference_comes_first_where_there_is_one():
    rows = [row("closed_form", 4.0, 2.0, case="C0", voxels=1000), *problems(1)]
    assert text(PART.text(rows, Settings())).startswith("Against the closed form:")
    assert not text(PART.text(rows, QUIET)).startswith("Against")


@pytest.mark.parametrize("count", [1, 2])
def test_sections_of_one_and_of_two_problems(count):
    rows = problems(count)
    rows[0]["seconds_assembly"], rows[1]["seconds_assembly"] = 0.5, 0.3
    rows[0]["poses"] = rows[1]["poses"] = None
    blocks = PART.report(rows, QUIET)
    lines = text(blocks).splitlines()
    assert ("## Every problem" in lines) == (count > 1)
    assert ("## Performance profile" in lines) == (count > 1)
    heads = [line for line in lines if line.startswith("## C")]
    # the least time of assembly, which all solvers share
    assert heads[0] == "## C0 (1,000 voxels, all poses, assembly 0.3 s): eq10"
    assert len(heads) == count
    assert not any("closed form" in line for line in lines)
    pictures = [block for block in blocks if isinstance(block, Picture)]
    assert ("profile.png" in [each.path for each in pictures]) == (count > 1)
    assert all(each.figure is not None for each in pictures)

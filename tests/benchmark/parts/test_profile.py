"""Bytes of a V-cycle: from the sizes of the levels, and bounded by what they hold."""

import pstats

import pytest

from tests.benchmark.parts.quick import measured
from tests.kit import small_scene
from ttus_opt.benchmark.machine import KEPT
from ttus_opt.benchmark.parts import profile
from ttus_opt.benchmark.parts.base import parts

#: What the passes of a V-cycle read and write, a word per colour: right side b, x,
#: residual r, inverse pivots d, conductances R, T, Z, weights w of the transfers
FINEST = """
b1 d1 x1 | d0 x0 x1 | x0 r1 d1 | r1 w0 w1 | w0 w1 x1 x1 | d0 x0 x1 | b1 d1 x1 x0
"""
COLOUR_0, COLOUR_1 = "b0 d0 R0 T0 T1 Z0 Z1 x0 x1", "b1 d1 R1 T0 T1 Z0 Z1 x1 x0"
WEIGHTS = "wr0 wr1 wt0 wt1 wz0 wz1"
COARSER = f"""
b1 d1 R1 x1 | {COLOUR_0} | x0 T0 T1 Z0 Z1 r1 | {COLOUR_1} | {COLOUR_0} |
x0 T0 T1 Z0 Z1 r1 r1 | r1 {WEIGHTS} | {WEIGHTS} x1 x1 |
{COLOUR_0} | {COLOUR_1} | {COLOUR_0} | {COLOUR_1}
"""


def laplace(shape):
    return small_scene("trilinear", shape=shape, n_poses=2, seed=0).laplace


def test_colours_are_those_of_the_passes():
    for passes, count in (
        (FINEST, profile.FINEST),
        (COARSER, profile.COARSER),
        ("b0 b1 x0 x1", profile.BELOW),
    ):
        assert len(passes.replace("|", " ").split()) == count


def test_bytes_are_those_of_the_levels():
    multigrid = laplace((12, 32, 16)).multigrid
    level, cycle = profile.cycle_bytes(multigrid)
    hierarchy = multigrid.hierarchy
    # one number in single precision per voxel, rows padded by less than a half
    assert 4 * 12 * 32 * 16 <= level < 1.5 * 4 * 12 * 32 * 16
    # no array is moved less than once, none of the finest level over twenty times
    own = hierarchy.fields, hierarchy.inverse, hierarchy.table
    assert cycle > sum(each.nbytes for each in own)
    coarser = sum(each.inverse.nbytes for each in hierarchy.levels[1:])
    direct = hierarchy.inverse.nbytes
    assert cycle - direct < 20 * level + 60 * coarser


def test_eight_times_the_voxels_are_eight_times_the_bytes():
    small, large = (
        profile.cycle_bytes(laplace(shape).multigrid)[1]
        for shape in ((12, 32, 16), (24, 64, 32))
    )
    assert large / small == pytest.approx(8.0, rel=0.25)


def test_what_is_measured_is_told():
    told = profile.roofline(laplace((12, 32, 16)))
    # a solve moves more than its V-cycles
    assert told["bytes_solve"] > told["cycles"] * told["bytes_cycle"]
    assert told["seconds_solve"] > told["seconds_cycle"] > 0.0
    known = told | {"bandwidth": 1e9, "bytes_cycle": 2_000_000, "seconds_cycle": 8e-3}
    text = "\n".join(map(str, profile.summary(known)))
    # 2 MB at 1 GB/s are 2 ms, a quarter of 8 ms
    assert "| V-cycle " in text
    line = next(each for each in text.splitlines() if each.startswith("| V-cycle "))
    cells = [cell.strip() for cell in line.strip("|").split("|")]
    assert cells[1:] == ["2", "2", "8", "25%"]


@pytest.mark.slow
def test_a_profile_has_the_fit_and_its_kernels(tmp_path):
    part = parts()["profile"]
    rows = measured(part, tmp_path)
    assert rows[0]["function"] == "benchmark.parts.profile._fit"
    assert rows[0]["ratio_to_fit"] == 1.0
    assert all(0.0 <= row["own"] <= row["total"] for row in rows)
    by = {row["function"]: row for row in rows}
    assert by["fitting.batch.Fitter.solve"]["calls"] == 1
    saved = pstats.Stats(str(tmp_path / KEPT / "profile-tiny.prof"))
    names = {name for _, _, name in saved.stats}
    # compiled kernels are told as well
    assert {"_fit", "solve", "v_cycle", "contact_rows"} <= names
    rows.append({"case": "gone", "status": "refused", "detail": "no file"})
    text = "\n".join(map(str, part.below(rows)))
    assert "GB/s" in text
    assert "profile-tiny.prof" in text
    assert "gone" not in text

"""A profile has the fit and its kernels."""

import pstats

import pytest

from tests.benchmark.parts.quick import measured
from ttus_opt.benchmark.parts.registry import parts
from ttus_opt.benchmark.progress import KEPT


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

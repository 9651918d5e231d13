"""Results that are kept: taken when they are of the same making, else made anew."""

from __future__ import annotations

from pathlib import Path

import pytest

from ttus_opt.experiment.fits import read_kept, write_kept


def test_a_result_of_the_same_making_is_taken(tmp_path: Path) -> None:
    file = tmp_path / "eq10.json"
    assert read_kept(file, {}) is None
    write_kept(file, {"weight": 1.0, "shape": (8, 16, 8), "error": float("nan")})
    found = read_kept(file, {"weight": 1.0, "shape": (8, 16, 8)})
    assert found == {"weight": 1.0, "shape": [8, 16, 8], "error": None}
    assert read_kept(file, {"weight": 2.0}) is None


@pytest.mark.parametrize(
    "content", [b"", b"{", b"null", b"[1]", b"\xff\xfe\x00", 100_000 * b"["]
)
def test_a_damaged_result_is_made_anew(tmp_path: Path, content: bytes) -> None:
    file = tmp_path / "eq10.json"
    file.write_bytes(content)
    assert read_kept(file, {}) is None

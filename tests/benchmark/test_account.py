"""The account of a profile: sums by hand, and sentences that carry them."""

from __future__ import annotations

from typing import Any

from ttus_opt.benchmark import account, spans
from ttus_opt.benchmark.flame import flame_graph

TRAFFIC = {
    "bytes_once": 10e6,
    "bytes_cycle": 40e6,
    "bytes_level": 4e6,
    "bytes_solve": 600e6,
    "cycles": 10,
    "corrections": 3,
    "seconds_cycle": 8e-3,
    "seconds_solve": 0.12,
    "bandwidth_memory": 10e9,
    "bandwidth_level": 20e9,
    "memory_size": 800_000_000,
    "cache": 32_000_000,
}


def row(*path: str, own: float, total: float, calls: int = 1) -> dict[str, Any]:
    return {"path": [spans.FIT, *path], "own": own, "total": total, "calls": calls}


ROWS = [
    row(own=1.0, total=10.0) | {"traffic": TRAFFIC},
    row(spans.ASSEMBLY, own=1.5, total=1.5),
    row(spans.DUAL, own=0.0, total=7.5),
    row(spans.DUAL, spans.ROUGH, own=0.5, total=1.5, calls=20),
    row(spans.DUAL, spans.ROUGH, spans.CYCLE, own=1.0, total=1.0, calls=40),
    row(spans.DUAL, spans.EXACT, own=3.0, total=6.0, calls=8),
    row(spans.DUAL, spans.EXACT, spans.CORRECTION, own=3.0, total=3.0, calls=16),
]


def test_seconds_of_a_span_wherever_it_stands() -> None:
    assert account.own_seconds(ROWS, spans.CORRECTION) == 3.0
    assert account.own_seconds(ROWS, spans.CYCLE, spans.ROUGH) == 1.0
    assert account.total_seconds(ROWS, spans.EXACT) == 6.0


def test_sentences_carry_the_figures() -> None:
    text = "\n".join(account.lines(ROWS))
    assert "10.0 GB/s for an array of 800 MB (beyond it;" in text
    assert "10 MB) fit into the last-level cache" in text
    # 40 MB at 20 GB/s are 2 of 8 ms: three of four seconds of V-cycles saved
    assert "| V-cycle, every pass           " in text
    assert "2 of its 8 ms would be left: at that bound the fit would take 7 " in text
    assert "around them: 4 s, 40% of the fit, 25% of it in rough" in text
    assert "8 exact ones at 750 ms" in text
    assert "20 rough ones at 75 ms" in text
    assert "1.5 s, 15% of the fit; were it free, the fit would take 8.5 " in text
    solve = next(line for line in text.splitlines() if "solve with A" in line)
    assert [cell.strip() for cell in solve.split("|")[2:6]] == [
        "600",
        "30",
        "120",
        "25%",
    ]


def test_bars_stand_below_their_parents() -> None:
    (axis,) = flame_graph(ROWS).axes
    bars = [(b.get_x(), b.get_width(), b.get_y()) for b in axis.patches]  # type: ignore[attr-defined]
    assert len(bars) == len(ROWS)
    starts = [0.0, 0.0, 1.5, 1.5, 1.5, 3.0, 3.0]
    assert [x for x, _, _ in bars] == starts
    assert [width for _, width, _ in bars] == [r["total"] for r in ROWS]
    depths = [round(y) for _, _, y in bars]
    assert depths == [-1, -2, -2, -3, -4, -3, -4]
    assert "exact products 60%" in {t.get_text() for t in axis.texts}

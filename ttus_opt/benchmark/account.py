"""What a profile leaves to be gained, written from its numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from ttus_opt.benchmark import spans as name
from ttus_opt.report.tables import table

Row = Mapping[str, Any]

MB, GB = 1e6, 1e9


def lines(rows: Sequence[Row]) -> list[str]:
    """The memory-traffic account and a sentence per group of spans, in Markdown.

    Args:
        rows: Of one profile, the root with its ``traffic`` first.
    """
    told = rows[0]["traffic"]
    return [*_traffic(told), "", *(f"- {each}" for each in _left(rows, told)), ""]


def own_seconds(rows: Sequence[Row], span: str, within: str = "") -> float:
    """Own seconds of all spans of one name.

    Args:
        rows: Of one profile.
        span: Their name.
        within: Only those below a span of this name; "" for all.
    """
    return math.fsum(
        row["own"]
        for row in rows
        if row["path"][-1] == span and (not within or within in row["path"][:-1])
    )


def total_seconds(rows: Sequence[Row], span: str) -> float:
    """Seconds in spans of one name and all below; none of them inside another."""
    return math.fsum(row["total"] for row in rows if row["path"][-1] == span)


def _calls(rows: Sequence[Row], span: str) -> int:
    return sum(row["calls"] for row in rows if row["path"][-1] == span)


def _traffic(told: Mapping[str, Any]) -> list[str]:
    """Bytes, limits and what was reached."""
    header = ["", "bytes [MB]", "limit [ms]", "measured [ms]", "of the limit"]
    body = [
        _line("V-cycle, every array once", told, "bytes_once", "seconds_cycle"),
        _line("V-cycle, every pass", told, "bytes_cycle", "seconds_cycle"),
        _line(
            f"solve with A: {told['cycles']} V-cycles, {told['corrections']} rounds",
            told,
            "bytes_solve",
            "seconds_solve",
        ),
    ]
    cache = told["cache"]
    known = "unknown" if cache is None else f"{cache / MB:.0f} MB as the system says"
    beyond = cache is not None and told["memory_size"] > cache
    place = "beyond it" if beyond else "as large as was allowed"
    return [
        f"A copy on one core, reads and writes counted, runs at "
        f"{told['bandwidth_memory'] / GB:.1f} GB/s for an array of "
        f"{told['memory_size'] / MB:.0f} MB ({place}; last-level cache {known}) and at "
        f"{told['bandwidth_level'] / GB:.1f} GB/s for one of "
        f"{told['bytes_level'] / MB:.2g} MB, the size of the finest level's. Limits "
        "are with the latter, as all levels together "
        f"({told['bytes_once'] / MB:.3g} MB) {_where(told)}.",
        "",
        table(header, body),
    ]


def _where(told: Mapping[str, Any]) -> str:
    if told["cache"] is None:
        return "may fit into the last-level cache"
    inside = told["bytes_once"] < told["cache"]
    return f"{'fit' if inside else 'do not fit'} into the last-level cache"


def _limit(told: Mapping[str, Any], moved: str) -> float:
    """Seconds that bytes take at the speed of a level [s]."""
    return float(told[moved] / told["bandwidth_level"])


def _line(label: str, told: Mapping[str, Any], moved: str, measured: str) -> list[str]:
    limit, taken = _limit(told, moved), told[measured]
    return [
        label,
        f"{told[moved] / MB:.3g}",
        f"{1e3 * limit:.3g}",
        f"{1e3 * taken:.3g}",
        f"{limit / taken:.0%}",
    ]


def _left(rows: Sequence[Row], told: Mapping[str, Any]) -> list[str]:
    """A sentence per group: what it takes, and how much faster a fit could be."""
    whole = rows[0]["total"]
    # a correction is one compiled call: its V-cycles and its vectors are not told apart
    cycles = own_seconds(rows, name.CYCLE) + own_seconds(rows, name.CORRECTION)
    vectors = own_seconds(rows, name.DOUBLE) + own_seconds(rows, name.SOLVE)
    limit = _limit(told, "bytes_cycle")
    vector_bytes = told["bytes_solve"] - told["cycles"] * told["bytes_cycle"]
    vector_limit = vector_bytes / told["bandwidth_level"]
    vector_taken = told["seconds_solve"] - told["cycles"] * told["seconds_cycle"]
    rough = own_seconds(rows, name.CYCLE, name.ROUGH)
    return [
        "V-cycles, and in solves the conjugate gradients around them: "
        f"{_part(cycles, whole)}, {rough / cycles:.0%} of it in rough products. Each "
        "V-cycle streams "
        f"{told['bytes_cycle'] / MB:.3g} MB, so that at the speed of a copy "
        f"{1e3 * limit:.3g} of its {1e3 * told['seconds_cycle']:.3g} ms would be left: "
        f"at that bound the fit would take "
        f"{_left_of(whole, cycles, limit / told['seconds_cycle'])}.",
        f"Double-precision residuals around them: {_part(vectors, whole)}. "
        "With the gradients' vectors they stream in a solve "
        f"{vector_bytes / MB:.3g} MB in {1e3 * vector_taken:.3g} ms where a copy would "
        "take "
        f"{1e3 * vector_limit:.3g} ms: at that bound the fit would take "
        f"{_left_of(whole, vectors, vector_limit / max(vector_taken, 1e-12))}.",
        f"Products: {_calls(rows, name.EXACT):,} exact ones at "
        f"{_each(rows, name.EXACT)}, two solves each, after a preconditioner of "
        f"{_calls(rows, name.ROUGH):,} rough ones at {_each(rows, name.ROUGH)}, two "
        "V-cycles each: fewer of the one ask for more of the other.",
        _free("Directions' algebra", own_seconds(rows, name.ALGEBRA), whole),
        _free(
            "What is done once per scene (assembly, program, set-up of solver and "
            "of multigrid)",
            sum(
                total_seconds(rows, span)
                for span in (name.ASSEMBLY, name.PROGRAM, name.PREPARE)
            ),
            whole,
        ),
        _free(
            "What makes and checks the answer (p₀, final response, KKT verification)",
            sum(
                total_seconds(rows, span)
                for span in (name.PRIOR, name.RESPONSE, name.VERIFY)
            ),
            whole,
        ),
    ]


def _part(taken: float, whole: float) -> str:
    return f"{taken:.3g} s, {taken / whole:.0%} of the fit"


def _left_of(whole: float, taken: float, kept: float) -> str:
    """The fit's time if of one group only a part were left."""
    saved = taken * max(0.0, 1.0 - kept)
    return f"{whole - saved:.3g} instead of {whole:.3g} s"


def _each(rows: Sequence[Row], span: str) -> str:
    """Milliseconds per call, all below included."""
    calls = _calls(rows, span)
    return f"{1e3 * total_seconds(rows, span) / calls:.3g} ms" if calls else "–"


def _free(what: str, taken: float, whole: float) -> str:
    return (
        f"{what}: {_part(taken, whole)}; were it free, the fit would take "
        f"{whole - taken:.3g} instead of {whole:.3g} s."
    )

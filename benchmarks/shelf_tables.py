"""Tables of the whole shelf for docs/benchmark.md, from what `ttus-opt benchmark` left.

    python benchmarks/shelf_tables.py [--wall] results [more-results ...]

Each folder has the ``rows.jsonl`` of one or more calls. The text between the markers of
docs/benchmark.md is replaced, and the performance profile is drawn to
docs/shelf_profile.png. Times are CPU seconds, so that other work on the machine matters
little, or those of the clock, where there was none; ratios are to eq. 10 by the same
solver choice in the same folder and case.
"""

from __future__ import annotations

import argparse
import json
import math
from collections.abc import Iterable, Sequence
from pathlib import Path

import numpy as np

from ttus_opt.benchmark.pictures import (
    LEGEND,
    profile_picture,
    profile_table,
    ranked,
)
from ttus_opt.benchmark.row import Row
from ttus_opt.benchmark.summary import seconds, was_run, worst_relative
from ttus_opt.benchmark.summary import solved as in_time
from ttus_opt.report.document import Table
from ttus_opt.report.plots.canvas import save_picture

ROOT = Path(__file__).resolve().parents[1]

AUTO, BASE, CASES = "auto", "eq10", ("S", "M", "L")

#: Formulations with penalties beside squares
PENALTIES = ("robust", "sparse_sources", "total_variation")

#: Terms of a user's own, benchmarks/own_terms
OWN = ("depth_weighted", "along_z", "skin_graph")


def read(folders: Iterable[Path], *, wall: bool = False) -> list[Row]:
    """Rows of all folders, the last of each question, with eq. 10's of its folder.

    Args:
        folders: With ``rows.jsonl``.
        wall: Take the clock's seconds for the CPU's.
    """
    found: dict[str, Row] = {}
    for folder in folders:
        own: dict[str, Row] = {}
        for line in (folder / "rows.jsonl").read_text("utf-8").splitlines():
            for row in json.loads(line):
                clock = {"cpu_first": row["seconds_first"]} if wall else {}
                own[row["key"]] = row | clock
        base = {
            (row["case"], row["solver"]): row["cpu_first"]
            for row in own.values()
            if row["formulation"] == BASE and solved(row)
        }
        known = {
            (row["case"], row["solver"])
            for row in found.values()
            if row["formulation"] == BASE
        }
        for key, row in own.items():
            place = row["case"], row["solver"]
            if row["formulation"] != BASE:
                found[key] = row | {"cpu_base": base.get(place)}
            elif place not in known:  # the first one is the table's
                found[key] = row
    return list(found.values())


def solved(row: Row) -> bool:
    """Whether there is a verified answer within the time limit, in CPU seconds."""
    late = str(row["detail"]).startswith("solved after")
    return in_time(row) or (late and row["cpu_first"] < row["time_limit"])


def by(rows: Iterable[Row], case: str, solver: str = AUTO) -> dict[str, Row]:
    """Rows of a case and a solver that were run, by formulation."""
    return {
        row["formulation"]: row
        for row in rows
        if (row["case"], row["solver"]) == (case, solver) and was_run(row)
    }


def ordered(names: Iterable[str]) -> list[str]:
    """Eq. 10 first, then the shelf, then penalties, then the own terms."""

    def place(name: str) -> tuple[bool, bool, bool, str]:
        return name != BASE, name in OWN, name in PENALTIES, name

    return sorted(dict.fromkeys(names), key=place)


def cpu(row: Row | None) -> str:
    """CPU seconds of the first answer, or why there is none."""
    if row is None:
        return "–"
    return seconds(row["cpu_first"]) if solved(row) else f"({row['status']})"


def times(row: Row | None, base: Row | None) -> float:
    """CPU time over eq. 10's, where it is known of the same folder; NaN without."""
    if row is None or base is None or not (solved(row) and solved(base)):
        return math.nan
    return float(row["cpu_first"] / (row.get("cpu_base") or base["cpu_first"]))


def factor(value: float) -> str:
    """A ratio with two digits; a dash for none."""
    return (
        "–"
        if math.isnan(value)
        else f"{value:.2g} ×"
        if value < 99
        else f"{value:.0f} ×"
    )


def growth(rows: Sequence[Row]) -> float:
    """Exponent x of CPU time ∝ V^x by least squares; NaN below two sizes."""
    told = [(row["voxels"], row["cpu_first"]) for row in rows if solved(row)]
    if len({size for size, _ in told}) < 2:
        return math.nan
    sizes, seconds = np.log(np.array(told, dtype=float)).T
    return float(np.polyfit(sizes, seconds, 1)[0])


def shelf_table(rows: Sequence[Row]) -> str:
    """A line per formulation: what auto took, CPU seconds and ratios, growth."""
    cases = {case: by(rows, case) for case in CASES}
    body = []
    for name in ordered(name for case in cases.values() for name in case):
        own = [case.get(name) for case in cases.values()]
        there = [row for row in own if row is not None]
        answered = [row for row in there if solved(row)]
        line = [name, ", ".join(dict.fromkeys(row["taken"] for row in answered)) or "–"]
        for case, row in zip(cases.values(), own, strict=True):
            line += [cpu(row), factor(times(row, case.get(BASE)))]
        law = growth(there)
        line.append("–" if math.isnan(law) else f"{law:.2f}")
        worst = [worst_relative(row) or 0.0 for row in answered]
        body.append([*line, f"{max(worst):.0e}" if worst else "–"])
    header = ["formulation", "auto took"]
    header += [word for case in CASES for word in (f"{case} [s]", "× eq. 10")]
    return str(Table([*header, "V^x", "KKT"], body))


def general_table(rows: Sequence[Row]) -> str:
    """On S: auto against general solvers, CPU seconds and the factor to the best."""
    own = by(rows, "S")
    names = {row["solver"] for row in rows if row["case"] == "S"} - {AUTO}
    others = {name: by(rows, "S", name) for name in sorted(names)}
    body = []
    for name in ordered(name for other in others.values() for name in other):
        mine = own.get(name)
        best = best_general(rows).get(name, math.nan)
        ahead = best / mine["cpu_first"] if mine and solved(mine) else math.nan
        told = [cpu(other.get(name)) for other in others.values()]
        body.append([name, cpu(mine), *told, factor(ahead)])
    return str(Table(["formulation", AUTO, *others, "best of them / auto"], body))


def perturbed_table(rows: Sequence[Row]) -> str:
    """On S with perturbed wrenches: CPU seconds, ratio, active limits, residual."""
    cases = {case: by(rows, case) for case in ("S-reversed", "S-noise")}
    body = []
    for name in ordered(name for case in cases.values() for name in case):
        line = [name]
        for case in cases.values():
            row = case.get(name)
            limits = row["active_limits"] if row else None
            residual = worst_relative(row) if row else None
            line += [cpu(row), factor(times(row, case.get(BASE)))]
            line.append("–" if limits is None else str(limits))
            line.append("–" if residual is None else f"{residual:.0e}")
        body.append(line)
    parts = ["× eq. 10", "active limits", "KKT"]
    header = ["formulation", "a fifth reversed [s]", *parts, "2 N of noise [s]", *parts]
    return str(Table(header, body))


def missed(rows: Sequence[Row]) -> list[str]:
    """Goals that these rows do not reach, a line each."""
    return [*_missed_m(rows), *_missed_l(rows), *_missed_growth(rows), *_missed_s(rows)]


def _missed_m(rows: Sequence[Row]) -> list[str]:
    on_m, found = by(rows, "M"), []
    for name, row in on_m.items():
        ratio, most = times(row, on_m.get(BASE)), 60.0 if name in PENALTIES else 10.0
        slow = not solved(row) or row["cpu_first"] > most
        if slow or (name not in PENALTIES and ratio > 5.0):
            goal = "60 s" if name in PENALTIES else "5 × eq. 10 and 10 s"
            found.append(f"`{name}` on M: {cpu(row)} s, {factor(ratio)} (goal {goal})")
    return found


def _missed_l(rows: Sequence[Row]) -> list[str]:
    found = []
    for name, row in by(rows, "L").items():
        size = (row["peak_memory_bytes"] or 0) / 2**30
        if not solved(row) or row["cpu_first"] > 40.0 or size > 3.0:
            reached = f"{cpu(row)} s, {size:.1f} GiB"
            found.append(f"`{name}` on L: {reached} (goal 40 s, 3 GiB)")
    return found


def _missed_growth(rows: Sequence[Row]) -> list[str]:
    cases = [by(rows, case) for case in CASES]
    found = {}
    for name in cases[-1]:  # from S to L
        found[name] = growth([case[name] for case in cases if name in case])
    return [
        f"`{name}` grows like V^{law:.2f} (goal V^1.2)"
        for name, law in found.items()
        if law > 1.2
    ]


def _missed_s(rows: Sequence[Row]) -> list[str]:
    found, best = [], best_general(rows)
    for name, row in by(rows, "S").items():
        least = 5.0 if name in PENALTIES else 20.0
        ahead = best.get(name, math.nan) / row["cpu_first"] if solved(row) else math.nan
        if ahead < least:
            found.append(
                f"`{name}` on S: {factor(ahead)} faster than the best general solver "
                f"(goal {least:g} ×)"
            )
    return found


def best_general(rows: Iterable[Row]) -> dict[str, float]:
    """CPU seconds of the fastest general solver on S, by formulation."""
    found: dict[str, float] = {}
    for row in rows:
        if row["case"] == "S" and row["solver"] != AUTO and solved(row):
            least = found.get(row["formulation"], math.inf)
            found[row["formulation"]] = min(least, row["cpu_first"])
    return found


def profile_rows(rows: Sequence[Row]) -> list[Row]:
    """Rows of S whose formulation a general solver was run on, by CPU time."""
    on_s = [row for row in rows if row["case"] == "S" and was_run(row)]
    names = {row["formulation"] for row in on_s if row["solver"] != AUTO}
    return [
        row
        | {"seconds_first": row["cpu_first"]}
        | ({"status": "solved"} if solved(row) else {})
        for row in on_s
        if row["formulation"] in names
    ]


def filled(path: Path, name: str, text: str) -> None:
    """Put a text between the markers of a file.

    Raises:
        ValueError: The file has no such markers.
    """
    whole = path.read_text(encoding="utf-8")
    begin, end = f"<!-- {name}: begin -->\n", f"<!-- {name}: end -->"
    before, found, rest = whole.partition(begin)
    _, ended, after = rest.partition(end)
    if not (found and ended):
        raise ValueError(f"{path} has no markers {begin.strip()} and {end}")
    path.write_text(f"{before}{begin}\n{text}\n\n{end}{after}", encoding="utf-8")


def main() -> None:
    """Fill in the tables and draw the profile."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folders", nargs="+", type=Path)
    parser.add_argument("--wall", action="store_true", help="of a quiet machine")
    asked = parser.parse_args()
    rows = read(asked.folders, wall=asked.wall)
    page, chosen = ROOT / "docs" / "benchmark.md", ranked(profile_rows(rows))
    filled(page, "shelf", shelf_table(rows))
    filled(page, "general", general_table(rows))
    n_problems = len(next(iter(chosen.values())))
    profile = f"{LEGEND.format(n=n_problems)}\n\n{profile_table(chosen)}"
    filled(page, "profile", profile)
    filled(page, "perturbed", perturbed_table(rows))
    goals = missed(rows)
    filled(page, "missed", "\n".join(f"- {line}." for line in goals) or "None.")
    save_picture(profile_picture(chosen), ROOT / "docs" / "shelf_profile.png")


if __name__ == "__main__":
    main()

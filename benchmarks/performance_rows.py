"""Measures every row of docs/benchmark.md, Performance, again, on a quiet machine.

    python benchmarks/performance_rows.py -o performance-rows
    python benchmarks/performance_rows.py -o performance-rows --only frame,ripple

One run at a time, about an hour in all, most of it `scs`, `clarabel` and `amg_pcg`; a
second call goes on where the first stopped. The answer is ``performance-rows/rows.md``:
every row as the page has it, and below it what was measured now. Nothing is written
into the page: figures go there by hand, all of one day.
"""

from __future__ import annotations

import argparse
import re
import shlex
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from ttus_opt.benchmark.machine import describe

ROOT = Path(__file__).resolve().parents[1]

_EQ10 = "--solvers structured --closed-form none"
_LIMITS = f"--formulations eq10_sign,eq10_sign_monotone {_EQ10}"
_ACTIVE = "--perturb reversed --weight 100"
_DRAG = f"--formulations coulomb_drag {_EQ10}"
_DRAG_GENERAL = (
    "--formulations coulomb_drag --closed-form none --time-limit 120 --solvers"
)

#: Arguments of `ttus-opt benchmark` by the beginning of a row, in the page's order
ROWS: dict[str, tuple[str, ...]] = {
    "eq. 10 on S / M / L": (f"--case all {_EQ10} --repeat 3 --memory",),
    "the same with other measured values": (),  # of the run above
    "eq. 10 on S, `closed_form_pardiso`": (
        "--case S --solvers structured,closed_form_pardiso,amg_pcg "
        "--closed-form closed_form_pardiso",
    ),
    "eq. 10 on M; L, `amg_pcg`": (
        "--case M,L --solvers structured,amg_pcg --closed-form none",
    ),
    "eq. 10 on M with weight": tuple(
        f"--case M --weight {weight} {_EQ10}" for weight in ("1e-6", "1e-2", "1e2")
    ),
    "with sign, and growth too, on S": (
        "--case S --formulations eq10_sign,eq10_sign_monotone "
        "--solvers structured,scs --closed-form none --time-limit 90",
    ),
    "the same on M, `structured`": (f"--case M {_LIMITS}",),
    "the same on S with 86 and 89": (
        f"--case S {_ACTIVE} --formulations eq10_sign,eq10_sign_monotone "
        "--solvers structured,scs --closed-form none --time-limit 120",
    ),
    "the same on M with 473 and 586": (f"--case M {_ACTIVE} {_LIMITS}",),
    "the same on M with voxel-mean rows": (
        f"--case M {_ACTIVE} {_LIMITS} --sampling voxel-mean",
    ),
    "Coulomb drag as a second field": (
        f"--case S {_DRAG_GENERAL} structured,scs,clarabel",
    ),
    "the same on S with 233": (f"--case S {_ACTIVE} {_DRAG_GENERAL} structured,scs",),
    "the same on M; with 1,168": (f"--case M {_DRAG}", f"--case M {_ACTIVE} {_DRAG}"),
    "sign, growth too, and drag on M": (
        "--case M --perturb noise --weight 100 "
        f"--formulations eq10_sign,eq10_sign_monotone,coulomb_drag {_EQ10}",
    ),
    "one measurement more": ("--case S,M --parts recursion",),
    "a frame, 5,000 points": ("--case S --parts rendering",),
    "ripple with 2 mm voxels": ("--parts ripple",),
    "L, b; N, W of 400 poses": ("--case L --parts assembly",),
    "one solve with A on L": ("--case L --parts profile",),
}


def told_rows() -> dict[str, str]:
    """What the page says, by its first column: the second column."""
    text = (ROOT / "docs" / "benchmark.md").read_text(encoding="utf-8")
    table = text.partition("| what | measured | command |")[2].partition("\n\n")[0]
    found = re.findall(r"^\| (.+?) \| (.+?) \| .+ \|$", table, re.M)
    return dict(found)


def begins(row: str) -> str:
    """The key of `ROWS` for a row of the page.

    Raises:
        KeyError: There is none, or more than one.
    """
    found = [key for key in ROWS if row.startswith(key)]
    if len(found) != 1:
        raise KeyError(f"rows for {row!r}: {found}; put it into ROWS")
    return found[0]


def measured(arguments: str, folder: Path) -> str:
    """What one command prints, its report's path left out."""
    command = [
        sys.executable,
        "-P",
        "-m",
        "ttus_opt",
        "benchmark",
        *shlex.split(arguments),
    ]
    done = subprocess.run(
        [*command, "-o", str(folder)], stdout=subprocess.PIPE, text=True, check=True
    )
    return done.stdout.rpartition("\n\n")[0].strip()


def main(given: Sequence[str] | None = None) -> None:
    """Run what is asked for and write the answer as it comes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=Path("performance-rows"))
    parser.add_argument("--only", default="", help="words of rows, between commas")
    asked = parser.parse_args(given)
    words = [word for word in asked.only.split(",") if word]
    machine = "; ".join(f"{name} {it}" for name, it in describe().items())
    told = [f"# The rows of docs/benchmark.md, measured again\n\n{machine}"]
    for row, said in told_rows().items():
        if words and not any(word in row for word in words):
            continue
        told.append(f"## {row}\n\nPage: {said}")
        for arguments in ROWS[begins(row)]:
            name = re.sub(r"\W+", "-", arguments).strip("-")
            text = measured(arguments, asked.output / name)
            told.append(f"`ttus-opt benchmark {arguments}`\n\n{text}")
        asked.output.mkdir(parents=True, exist_ok=True)
        report = asked.output / "rows.md"
        report.write_text("\n\n".join([*told, ""]), encoding="utf-8")
        print(f"{row}: in {report}")


if __name__ == "__main__":
    main()

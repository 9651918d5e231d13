"""The process of one run: ``python -m ttus_opt.benchmark.worker FOLDER``.

It reads its input from the folder, reports every stage, and writes its rows there. Its
parent ends it when a stage takes too long (`ttus_opt.benchmark.isolation`).
"""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

from ttus_opt.benchmark import machine
from ttus_opt.benchmark.isolation import ANSWER, QUESTION
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.benchmark.row import MEASURED, Row, RunSpec
from ttus_opt.core.errors import MissingPackageError, TtusError


def run(spec: RunSpec, folder: Path) -> list[Row]:
    """Measure one run in this process; a refused one has a row without values.

    Args:
        spec: The run.
        folder: Folder for stages and files to keep.
    """
    part, begin = parts()[spec.part], Progress(folder)
    status, detail, rows = MEASURED, "", [Row()]
    try:
        rows = part.measure(spec, begin)
    except MissingPackageError as error:
        status, detail = "not installed", str(error)
    except MemoryError as error:
        status, detail = "memory limit", f"out of memory {error}".strip()
    except TtusError as error:
        status, detail = "refused", str(error)
    begin.end()
    same = part.row(spec, status, detail) | {
        "peak_memory_bytes": max(begin.peaks.values(), default=machine.peak_bytes()),
        "memory_by_stage": begin.peaks,
    }
    return [same | row for row in rows]


def main(folder: Path) -> None:
    """Run the folder's input."""
    machine.end_this_first()
    spec = RunSpec.from_dict(json.loads((folder / QUESTION).read_text("utf-8")))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        rows = run(spec, folder)
    (folder / ANSWER).write_text(json.dumps(rows), "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

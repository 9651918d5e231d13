"""The process of one part's run: ``python -m ttus_opt.benchmark.parts.worker FOLDER``.

The same as `ttus_opt.benchmark.worker` is for a solver's run.
"""

from __future__ import annotations

import json
import sys
import warnings
from pathlib import Path

from ttus_opt.benchmark import memory
from ttus_opt.benchmark.isolation import ANSWER, QUESTION
from ttus_opt.benchmark.parts.base import MEASURED, PartSpec
from ttus_opt.benchmark.parts.registry import parts
from ttus_opt.benchmark.stages import STAGES, Stages
from ttus_opt.errors import TtusError


def main(arguments: list[str]) -> None:
    """Run what the folder asks for.

    Args:
        arguments: The folder.
    """
    memory.volunteer()
    folder = Path(arguments[0])
    spec = PartSpec.from_dict(json.loads((folder / QUESTION).read_text("utf-8")))
    begin = Stages(folder / STAGES)
    status, detail = MEASURED, ""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            rows = parts()[spec.part].measure(spec, begin)
        except MemoryError as error:
            status, detail = "memory limit", f"out of memory {error}".strip()
            rows = [{}]
        except TtusError as error:
            status, detail, rows = "refused", str(error), [{}]
    begin.end()
    same = {
        **spec.options,
        "key": spec.key,
        "case": spec.case_name,
        "status": status,
        "detail": detail,
        "peak_memory_bytes": max(begin.peaks.values(), default=memory.peak_bytes()),
        "memory_by_stage": begin.peaks,
    }
    (folder / ANSWER).write_text(json.dumps([same | row for row in rows]), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])

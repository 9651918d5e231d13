"""A run in its own process, so that a crash or memory exhaustion is only a row."""

from __future__ import annotations

import json
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ttus_opt.benchmark.machine import KEPT, RESIDUAL, STAGES, resident_bytes
from ttus_opt.benchmark.parts.base import parts
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.core.child_process import environment, python_module

#: The process of a run
WORKER = "ttus_opt.benchmark.worker"

#: Files of a process's folder: its input, its result, its output
QUESTION, ANSWER, LOG = "run.json", "rows.json", "log.txt"

#: Polling interval [s]
PAUSE = 0.1

#: Tolerance of a stage's time limit, a factor and seconds, before it is ended
LATE_FACTOR, LATE_SECONDS = 1.1, 5.0

#: The stage of set-up and first solve, and its factor: a solver's limit begins after
#: its set-up, and it needs time to report its progress
SOLVING, SOLVING_FACTOR = "first", 2.0

#: Stages that compile and assemble, and their least time limit [s]
PREPARING, PREPARATION = ("start", "warm-up", "scene", "program"), 900.0

#: Called during a run with its stage and the stage's duration so far [s]
Watching = Callable[[str, float], None]


def run_isolated(
    spec: RunSpec,
    output: Path,
    memory_limit: int | None = None,
    watching: Watching | None = None,
) -> list[Row]:
    """Run in a separate process and return its rows, also of a failure.

    Args:
        spec: The run.
        output: Folder for files that the run keeps.
        memory_limit: Largest resident size; None for no limit [byte].
        watching: Called several times a second.
    """
    with tempfile.TemporaryDirectory(
        prefix="ttus-benchmark-", ignore_cleanup_errors=True
    ) as name:
        folder = Path(name)
        (folder / QUESTION).write_text(json.dumps(asdict(spec)), "utf-8")
        failure, detail, peak = _run(spec.time_limit, folder, memory_limit, watching)
        if failure:
            row = parts()[spec.part].row(spec, failure, detail)
            return [row | {"peak_memory_bytes": peak or None} | _reached(folder)]
        if (folder / KEPT).is_dir():
            shutil.copytree(folder / KEPT, output, dirs_exist_ok=True)
        rows: list[Row] = json.loads((folder / ANSWER).read_text("utf-8"))
        return rows


def _run(
    time_limit: float,
    folder: Path,
    memory_limit: int | None,
    watching: Watching | None,
) -> tuple[str, str, int]:
    """Status and detail of a failure, otherwise empty; largest size seen [byte]."""
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(
            python_module(WORKER, str(folder)),
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment(),
        )
        ended, peak = "", 0
        try:
            while not ended and process.poll() is None:
                time.sleep(PAUSE)
                size = resident_bytes(process.pid)
                peak = max(peak, size)
                stage, since = _stage(folder)
                if watching is not None:
                    watching(stage, since)
                if memory_limit is not None and size > memory_limit:
                    ended = "memory limit"
                elif since > _allowed(stage, time_limit):
                    ended = "time limit"
        finally:
            if process.poll() is None:
                process.kill()
            process.wait()
    stage, _ = _stage(folder)
    if ended:
        return ended, f"ended during {stage}", peak
    if process.returncode != 0 or not (folder / ANSWER).exists():
        cause = f"{_cause(process.returncode)} during {stage}"
        return "crashed", f"{cause}: {_last_line(folder)}", peak
    return "", "", peak


def _allowed(stage: str, time_limit: float) -> float:
    """Longest time of a stage before it is ended [s]."""
    factor = SOLVING_FACTOR if stage == SOLVING else LATE_FACTOR
    late = time_limit * factor + LATE_SECONDS
    return max(PREPARATION, late) if stage in PREPARING else late


def _reached(folder: Path) -> Row:
    """The residual that an ended run had reached, if it reported one."""
    try:
        return {"residual_reached": float((folder / RESIDUAL).read_text("utf-8"))}
    except (OSError, ValueError):  # none, or ended while it was being written
        return {}


def _stage(folder: Path) -> tuple[str, float]:
    """The current stage of the process, and its duration so far [s]."""
    try:
        lines = (folder / STAGES).read_text("utf-8").splitlines()
        last: dict[str, Any] = json.loads(lines[-1])
    except (OSError, IndexError, json.JSONDecodeError):
        return "start", 0.0  # none yet, or read while it was being written
    return str(last["stage"]), time.time() - float(last["time"])


def _cause(code: int) -> str:
    if code >= 0:
        return f"exit status {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def _last_line(folder: Path) -> str:
    lines = (folder / LOG).read_text("utf-8", errors="replace").splitlines()
    printed = [line.strip() for line in lines if line.strip()]
    return printed[-1] if printed else "no output"

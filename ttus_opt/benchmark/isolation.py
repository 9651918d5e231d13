"""A run in its own process: a crash or a memory blow-up is a row, not an end."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from ttus_opt.benchmark.memory import resident_bytes
from ttus_opt.benchmark.parts.registry import parts
from ttus_opt.benchmark.progress import KEPT, RESIDUAL, STAGES
from ttus_opt.benchmark.row import Row, RunSpec

#: The process of a run
WORKER = "ttus_opt.benchmark.worker"

#: Files of a process's folder: what it is asked, what it answers, what it prints
QUESTION, ANSWER, LOG = "run.json", "rows.json", "log.txt"

#: How often the process is looked at [s]
PAUSE = 0.1

#: A stage that computes is ended when it is late by this factor and these seconds; one
#: that observes its time limit has stopped by then
LATE_FACTOR, LATE_SECONDS = 1.1, 5.0

#: The stage of set-up and first solve, and its factor: a solver's limit counts from the
#: end of its set-up, and it needs time to report how far it came
SOLVING, SOLVING_FACTOR = "first", 2.0

#: Stages that compile and assemble, and the least time they are given [s]
PREPARING, PREPARATION = ("start", "warm-up", "scene", "program"), 900.0

#: Called while a run is under way: with its stage, and for how long that has lasted [s]
Watching = Callable[[str, float], None]


def run_isolated(
    spec: RunSpec,
    output: Path,
    memory_limit: int | None = None,
    watching: Watching | None = None,
) -> list[Row]:
    """Run in a process of its own and wait for it.

    Args:
        spec: What to run.
        output: Folder for the files that the run leaves.
        memory_limit: Largest resident size it may reach; None for no limit [byte].
        watching: Called several times a second.

    Returns:
        Its rows, whatever happened.
    """
    with tempfile.TemporaryDirectory(
        prefix="ttus-benchmark-", ignore_cleanup_errors=True
    ) as name:
        folder = Path(name)
        (folder / QUESTION).write_text(json.dumps(spec.as_dict()), "utf-8")
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
    """Status and detail of a failure, or empty words; largest size seen [byte]."""
    with (folder / LOG).open("wb") as log:
        process = subprocess.Popen(
            [sys.executable, "-m", WORKER, str(folder)],
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=_environment(),
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
    """After how long a stage is ended [s]."""
    factor = SOLVING_FACTOR if stage == SOLVING else LATE_FACTOR
    late = time_limit * factor + LATE_SECONDS
    return max(PREPARATION, late) if stage in PREPARING else late


def _reached(folder: Path) -> Row:
    """The residual a run had reached when it was ended, if it noted one."""
    try:
        return {"residual_reached": float((folder / RESIDUAL).read_text("utf-8"))}
    except (OSError, ValueError):  # none, or ended while it was being written
        return {}


def _environment() -> dict[str, str]:
    """This process's environment, with its import path for the child."""
    paths = [p for p in sys.path if p] + [str(Path.cwd())]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths))}


def _stage(folder: Path) -> tuple[str, float]:
    """What the process is doing, and for how long [s]."""
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
    told = [line.strip() for line in lines if line.strip()]
    return told[-1] if told else "it said nothing"

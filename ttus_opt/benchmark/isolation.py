"""A run in its own process: a crash or a memory blow-up is a row, not an end."""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ttus_opt.benchmark.memory import resident_bytes
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.benchmark.stages import STAGES

#: The process of a solver's run
WORKER = "ttus_opt.benchmark.worker"

#: Files of a process's folder: what it is asked, what it answers
QUESTION, ANSWER = "run.json", "row.json"

#: How often the process is looked at [s]
PAUSE = 0.1

#: A stage that solves is ended when it is late by this factor and these seconds: who
#: knows its time limit stops by itself before
LATE_FACTOR, LATE_SECONDS = 1.1, 5.0

#: Most time for compilation and assembly [s]
PREPARATION = 900.0


@dataclass(frozen=True)
class Outcome:
    """How a process ended.

    Attributes:
        folder: What it left behind; gone when the context ends.
        peak: Largest size it was seen with [byte].
        failure: ``time limit``, ``memory limit``, ``crashed``, …; empty for none.
        detail: The failure in words.
    """

    folder: Path
    peak: int
    failure: str = ""
    detail: str = ""


#: Most seconds a stage may take, and what it is called when it takes more
Allowance = Callable[[str], tuple[float, str]]


def run_isolated(spec: RunSpec, fields: Path, memory_limit: int | None = None) -> Row:
    """Run in a process of its own and wait for it.

    Args:
        spec: What to run.
        fields: Folder for the field.
        memory_limit: Largest resident size it may reach; None for no limit [byte].

    Returns:
        Its row, whatever happened.
    """

    def allowed(stage: str) -> tuple[float, str]:
        if stage in ("first", "again"):
            return late(spec.time_limit), "time limit"
        return PREPARATION, "assembly took too long"

    with isolated(WORKER, spec.as_dict(), allowed, memory_limit) as outcome:
        if outcome.failure:
            known = {"peak_memory_bytes": outcome.peak or None}
            return Row.failed(spec, outcome.failure, outcome.detail, **known)
        row = Row(**json.loads((outcome.folder / ANSWER).read_text("utf-8")))
        if row.field_file:
            fields.mkdir(parents=True, exist_ok=True)
            shutil.move(outcome.folder / row.field_file, fields / row.field_file)
        peak = row.peak_memory_bytes or outcome.peak or None
        return replace(row, key=spec.key, peak_memory_bytes=peak)


def late(time_limit: float) -> float:
    """When a stage that should have stopped by itself is ended [s]."""
    return time_limit * LATE_FACTOR + LATE_SECONDS


@contextlib.contextmanager
def isolated(
    module: str,
    question: Mapping[str, Any],
    allowed: Allowance,
    memory_limit: int | None = None,
) -> Iterator[Outcome]:
    """Run a module in a process of its own and watch it until it ends.

    The module is given a folder with the question in `QUESTION`; it tells its stages
    (`ttus_opt.benchmark.stages`) and leaves its answer in `ANSWER`.

    Args:
        module: Run with ``python -m``.
        question: What it is asked, for JSON.
        allowed: Called with the stage the process is in.
        memory_limit: Largest resident size it may reach; None for no limit [byte].

    Yields:
        How it ended; without a failure the answer is there.
    """
    folder = Path(tempfile.mkdtemp(prefix="ttus-benchmark-"))
    try:
        (folder / QUESTION).write_text(json.dumps(question), "utf-8")
        with (folder / "log.txt").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", module, str(folder)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=Path.cwd(),
                env=_environment(),
            )
            try:
                ended, peak = _watch(process, allowed, folder, memory_limit)
            finally:
                if process.poll() is None:
                    process.kill()
                process.wait()
        stage, _ = _stage(folder)
        if ended:
            yield Outcome(folder, peak, ended, f"ended during {stage}")
        elif process.returncode != 0 or not (folder / ANSWER).exists():
            cause = f"{_cause(process.returncode)} during {stage}"
            yield Outcome(folder, peak, "crashed", f"{cause}: {_last_line(folder)}")
        else:
            yield Outcome(folder, peak)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _environment() -> dict[str, str]:
    """This process's environment, with its import path for the child."""
    paths = [p for p in sys.path if p] + [str(Path.cwd())]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths))}


def _watch(
    process: subprocess.Popen[bytes],
    allowed: Allowance,
    folder: Path,
    memory_limit: int | None,
) -> tuple[str, int]:
    """Why the process was ended, empty when it ended by itself, and its peak."""
    peak = 0
    while process.poll() is None:
        time.sleep(PAUSE)
        size = resident_bytes(process.pid)
        peak = max(peak, size)
        if memory_limit is not None and size > memory_limit:
            return "memory limit", peak
        stage, begun = _stage(folder)
        most, word = allowed(stage)
        if begun is not None and time.time() - begun > most:
            return word, peak
    return "", peak


def _stage(folder: Path) -> tuple[str, float | None]:
    """What the process is doing and since when."""
    file = folder / STAGES
    if not file.exists():
        return "start", None
    lines = file.read_text("utf-8").splitlines()
    if not lines:
        return "start", None
    try:
        last: dict[str, Any] = json.loads(lines[-1])
    except json.JSONDecodeError:  # read while it was being written
        return "start", None
    return str(last["stage"]), float(last["time"])


def _cause(code: int) -> str:
    if code >= 0:
        return f"exit status {code}"
    try:
        return signal.Signals(-code).name
    except ValueError:
        return f"signal {-code}"


def _last_line(folder: Path) -> str:
    lines = (folder / "log.txt").read_text("utf-8", errors="replace").splitlines()
    told = [line.strip() for line in lines if line.strip()]
    return told[-1] if told else "it said nothing"

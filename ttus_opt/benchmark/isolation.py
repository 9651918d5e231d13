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
from dataclasses import replace
from pathlib import Path
from typing import Any

from ttus_opt.benchmark.memory import resident_bytes
from ttus_opt.benchmark.row import Row, RunSpec

#: How often the process is looked at [s]
PAUSE = 0.1

#: A stage that solves is ended when it is late by this factor and these seconds: who
#: knows its time limit stops by itself before
LATE_FACTOR, LATE_SECONDS = 1.1, 5.0

#: Most time for compilation and assembly [s]
PREPARATION = 900.0


def run_isolated(spec: RunSpec, fields: Path, memory_limit: int | None = None) -> Row:
    """Run in a process of its own and wait for it.

    Args:
        spec: What to run.
        fields: Folder for the field.
        memory_limit: Largest resident size it may reach; None for no limit [byte].

    Returns:
        Its row, whatever happened.
    """
    folder = Path(tempfile.mkdtemp(prefix="ttus-benchmark-"))
    try:
        (folder / "run.json").write_text(json.dumps(spec.as_dict()), "utf-8")
        with (folder / "log.txt").open("wb") as log:
            process = subprocess.Popen(
                [sys.executable, "-m", "ttus_opt.benchmark.worker", str(folder)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                cwd=Path.cwd(),
                env=_environment(),
            )
            try:
                ended, peak = _watch(process, spec, folder, memory_limit)
            finally:
                if process.poll() is None:
                    process.kill()
                process.wait()
        return _collected(spec, folder, fields, process.returncode, ended, peak)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _environment() -> dict[str, str]:
    """This process's environment, with its import path for the child."""
    paths = [p for p in sys.path if p] + [str(Path.cwd())]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(paths))}


def _watch(
    process: subprocess.Popen[bytes],
    spec: RunSpec,
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
        solving = stage in ("first", "again")
        allowed = (
            spec.time_limit * LATE_FACTOR + LATE_SECONDS if solving else PREPARATION
        )
        if begun is not None and time.time() - begun > allowed:
            return ("time limit" if solving else "assembly took too long"), peak
    return "", peak


def _stage(folder: Path) -> tuple[str, float | None]:
    """What the process is doing and since when."""
    file = folder / "stages.jsonl"
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


def _collected(
    spec: RunSpec, folder: Path, fields: Path, code: int, ended: str, peak: int
) -> Row:
    stage, _ = _stage(folder)
    known = {"peak_memory_bytes": peak or None}
    if ended:
        return Row.failed(spec, ended, f"ended during {stage}", **known)
    written = folder / "row.json"
    if code != 0 or not written.exists():
        return Row.failed(
            spec,
            "crashed",
            f"{_cause(code)} during {stage}: {_last_line(folder)}",
            **known,
        )
    row = Row(**json.loads(written.read_text("utf-8")))
    if row.field_file:
        fields.mkdir(parents=True, exist_ok=True)
        shutil.move(folder / row.field_file, fields / row.field_file)
    return replace(row, key=spec.key)


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

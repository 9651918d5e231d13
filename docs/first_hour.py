"""Writes docs/first-hour.md: a laboratory's first hour, as its terminal shows it.

A laboratory's files are made from the bundled example: a scan as text in millimetres,
the probe as STL, recordings with ROS's column names whose quaternions are x, y, z, w
under names that say w, x, y, z, and whose wrenches are those of the probe on the skin.
Every command after the first follows from what the one before said: the words that mend
are read from its output. The script ends with an error when a command says something
else, or when the unseen force error is not below `GOAL`.
"""

from __future__ import annotations

import contextlib
import json
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
import trimesh

import ttus_opt as tt
from ttus_opt import example

PAGE = Path(__file__).parent / "first-hour.md"

#: Largest mean force error on a recording that was not fitted [N]
GOAL = 0.2

#: Semi-axes of the example's probe [mm]
PROBE = (30.0, 12.5, 18.0)

HEAD = """# A laboratory's first hour

This page takes your own scan, probe and recordings to a fitted field, and shows the
mistakes of a first attempt. You need

- `scan.xyz`, written by a depth camera in millimetres;
- `probe.stl`, from CAD;
- `press.csv` and `sweep.csv` to fit and `unseen.csv` to evaluate, exported from ROS, in
  the patient frame of the surface file (for those of a robot or tracker see
  [registration](how-to/registration.md) and the option `--base-to-scan`).

The output is what the terminal shows, with times left out. `make docs` runs these
commands on files made from the bundled example (`docs/first_hour.py`) and fails when
one of them does not say what to do next."""

#: Written by the recorder for time and quaternion; the rest is as ROS exports it
NAMES = (
    "time",
    *(f"pose.position.{axis}" for axis in "xyz"),
    *("qw", "qx", "qy", "qz"),
    *(f"wrench.force.{axis}" for axis in "xyz"),
    *(f"wrench.torque.{axis}" for axis in "xyz"),
)


@dataclass
class Terminal:
    """Runs commands and keeps what a terminal would show."""

    lines: list[str] = field(default_factory=list)

    def tell(self, text: str) -> None:
        """A sentence between commands."""
        self.lines += ["", text, ""]

    def run(self, command: str, *, statuses: tuple[int, ...] = (0,)) -> str:
        """Run a command of ttus-opt; what it said.

        Raises:
            SystemExit: It ended with another status.
        """
        words = [
            sys.executable,
            "-P",
            "-m",
            *shlex.split(command.replace("-opt", "_opt", 1)),
        ]
        done = subprocess.run(
            words, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
            check=False, env={**os.environ, "COLUMNS": "80"},
        )  # fmt: skip
        said = re.sub(r"[^\n]*\r", "", done.stdout)  # a bar is written over
        kept = (n for n in said.split("\n") if n.strip() and not _is_bar(n))
        said = "\n".join(kept)
        if done.returncode not in statuses:
            raise SystemExit(f"{command}\nended with {done.returncode}:\n{said}")
        shown = re.sub(r"\b\d+(\.\d+)?(e-\d+)? s\b", "… s", said.strip())
        self.lines += ["```console", f"$ {command}", *shown.splitlines(), "```"]
        return said


def _is_bar(line: str) -> bool:
    return bool(re.search(r"\|[█▏▎▍▌▋▊▉ ]*\| \d+/\d+", line))


def write_scan_and_probe() -> None:
    """The scan as text and the probe as STL, both in millimetres."""
    cloud = tt.read_cloud(example.path("scan.ply"), unit="m")
    np.savetxt("scan.xyz", 1e3 * cloud, fmt="%.2f")
    write_probe()


def write_probe() -> None:
    """The example's probe as STL in millimetres."""
    probe = trimesh.creation.icosphere(subdivisions=4)
    probe.apply_scale(PROBE)
    probe.export("probe.stl")


def write_recordings(surface: Path) -> None:
    """The example's recordings in the frame that the surface file states."""
    old = tt.Surface.load(example.path("surface.nc")).axis
    new = tt.Surface.load(surface).axis
    turn = new.rotation.T @ old.rotation
    shift = new.rotation.T @ (old.origin - new.origin)
    for source, name in (
        ("press_fit", "press.csv"),
        ("sweep_fit", "sweep.csv"),
        ("press_test", "unseen.csv"),
    ):
        told = tt.read_trajectory(example.path(f"{source}.csv"))
        assert told.force is not None and told.torque is not None
        moved = replace(
            told, position=told.position @ turn.T + shift, rotation=turn @ told.rotation
        )
        columns = [
            told.time[:, None],
            moved.position,
            moved.quat_wxyz[:, [1, 2, 3, 0]],  # x, y, z, w
            -told.force @ turn.T,  # of the probe on the skin
            -told.torque @ turn.T,
        ]
        np.savetxt(
            name, np.hstack(columns), "%.9g", ",", header=",".join(NAMES), comments=""
        )


def mended(said: str, pattern: str) -> str:
    """The words of a command's output that say what to type.

    Raises:
        SystemExit: It did not say it.
    """
    found = re.search(pattern, " ".join(said.split()))
    if found is None:
        raise SystemExit(f"expected {pattern!r} in:\n{said}")
    return found[1]


def first_hour() -> list[str]:
    """Run it in the present folder; the page's lines.

    Raises:
        SystemExit: A command did not say what to do, or the goal is missed.
    """
    terminal = Terminal()
    write_scan_and_probe()
    scan = "ttus-opt surface scan.xyz -o surface.nc"
    terminal.tell("## The scan")
    said = terminal.run(scan, statuses=(2,))
    terminal.tell("The error names the missing option:")
    terminal.run(f"{scan} {mended(said, r'(--unit mm)')}")
    write_recordings(Path("surface.nc"))
    terminal.tell("## The recordings")
    fit = (
        "ttus-opt fit --surface surface.nc --probe probe.stl --trajectory press.csv "
        "--trajectory sweep.csv --sampling trilinear --shape 40,96,48 -o field.nc"
    )
    said = terminal.run(f"{fit} --picture poses.png")
    value = r"(?: (?!--)\S+(?<!:)(?!\S))?"  # of an option; no file that is told next
    mends = mended(said, rf"read them with ((?:--[a-z-]+{value} ?)+)").strip()
    terminal.tell(
        "The warning says how the recordings were probably written. Add these options:"
    )
    said = terminal.run(f"{fit} {mends}")
    if "read them with" in said:
        raise SystemExit(f"still in doubt:\n{said}")
    terminal.tell("## An unseen recording")
    evaluate = (
        "ttus-opt evaluate --field field.nc --probe probe.stl --trajectory unseen.csv "
        f"{mends}"
    )
    error = unseen_error(terminal, evaluate, GOAL)
    terminal.tell(
        f"The mean force error is {error:.2f} N on a recording that had no part in "
        "the fit. From here, [rendering](how-to/rendering.md) puts the field under an "
        "operator's hand, and [choosing weights](how-to/choosing-weights.md) explains "
        "the lines about weights."
    )
    return terminal.lines


def unseen_error(terminal: Terminal, evaluate: str, goal: float) -> float:
    """Show an evaluation; its mean force error [N].

    Raises:
        SystemExit: It is not below the goal [N].
    """
    terminal.run(evaluate)
    told = Terminal().run(f"{evaluate} --json")
    error = float(json.loads(told)["force_magnitude_error_N"])
    if not error < goal:
        raise SystemExit(f"unseen force error {error:.3f} N, expected below {goal} N")
    return error


def write_page(page: Path, head: str, transcript: Callable[[], list[str]]) -> None:
    """Run a transcript in a folder of its own, and write its page."""
    with tempfile.TemporaryDirectory() as folder, contextlib.chdir(folder):
        lines = transcript()
    page.write_text("\n".join([head, *lines, ""]), encoding="utf-8")


if __name__ == "__main__":
    write_page(PAGE, HEAD, first_hour)

"""``ttus-opt live demo``: the same hand, patient and link with four kinds of feedback.

Every comparator examines the simulated torso without delay and with a round trip of a
second, from a prior that is 1.6 times too stiff. The result is a table, a picture, and
a recording of one session that `ttus-opt live replay` renders again.
"""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from multiprocessing import active_children
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from ttus_opt.core import io
from ttus_opt.core.interrupts import signals_deferred
from ttus_opt.live.recording import Recorder
from ttus_opt.live.trial import COMPARATORS, Trial, TrialResult, run
from ttus_opt.report.document import Heading, Items, Picture, Table, Text, write_report
from ttus_opt.report.plots.canvas import (
    AFTER,
    MEASURED,
    look,
    new_figure,
    save_picture,
)

#: Round trips [s]
ROUND_TRIPS = (0.0, 1.0)

#: Sessions of the demo
N_SESSIONS = len(COMPARATORS) * len(ROUND_TRIPS)

#: Energy from which feedback counts as active [J]: twice the reserve of updates
ACTIVE = 0.1

NOTICE = (
    "Not a medical device. This is research software; no part of it has been tested "
    "for use on people."
)


@dataclass(frozen=True)
class LiveDemo:
    """Result of the demo.

    Attributes:
        results: One per comparator and round trip.
        recording: File of the model's session with delay.
        seconds: Duration [s].
    """

    results: tuple[TrialResult, ...] = field(repr=False)
    recording: Path
    seconds: float

    def as_dict(self) -> dict[str, Any]:
        """All figures by name, for JSON."""
        return {
            "notice": NOTICE,
            "recording": str(self.recording),
            "seconds": self.seconds,
            "trials": [one.as_dict() for one in self.results],
        }

    @property
    def table(self) -> Table:
        """A row for every session."""
        return comparison(self.results)


def run_demo(
    folder: str | os.PathLike[str],
    *,
    prior: float = 1.6,
    loss: float = 0.02,
    processes: int = 1,
    progress: Callable[[str], None] | None = None,
) -> LiveDemo:
    """Run all sessions and write report, picture and recording.

    Args:
        folder: Output folder, created if missing.
        prior: Factor by which the prior is too stiff [–].
        loss: Share of lost packets, in bursts of three [–].
        processes: Sessions at a time [–]; with more than one, the main module must not
            start them without ``if __name__ == "__main__"``.
        progress: Called with what is waited for, once for every session.

    Raises:
        InputError: A prior or a loss out of range.
        FileError: The folder cannot be written to.
    """
    start = time.perf_counter()
    trials = [
        Trial(name, round_trip, prior, loss=loss, burst=3.0)
        for name in COMPARATORS
        for round_trip in ROUND_TRIPS
    ]
    out = io.made_folder(Path(folder))
    recording = out / "session.mcap"
    results = _all(trials, recording, processes, progress or (lambda _: None))
    save_picture(live_picture(results), out / "live.png")
    found = LiveDemo(tuple(results), recording, time.perf_counter() - start)
    blocks = [
        Heading("A live session", 1),
        Text(f"**{NOTICE}**"),
        Text(
            f"A simulated hand presses a simulated torso (finite elements) over a link "
            f"that loses {100 * loss:g} % of packets in bursts; the prior is {prior:g} "
            "times too stiff. The error is between the force that the hand feels and "
            "that of the torso at the hand's own pose at that moment, after 10 s: each "
            "of three places was pressed once. Energy is the most that the hand had "
            "got: a patient gives none."
        ),
        comparison(results),
        Picture("live.png", "Felt (blue) and true force (grey) at the hand's pose"),
        Items([f"`{name}`: {line}" for name, line in COMPARATORS.items()]),
        Text(
            "The session of the model with delay is in `session.mcap`: "
            "`ttus-opt live replay --recording session.mcap` renders it again, bit by "
            "bit."
        ),
    ]
    write_report(out, blocks)
    return found


def _all(
    trials: Sequence[Trial],
    recording: Path,
    processes: int,
    say: Callable[[str], None],
) -> list[TrialResult]:
    """Results of all trials, so many at a time; the last of the model is recorded."""
    recorded = [t for t in trials if t.comparator == "model"][-1]
    tasks = [(t, recording if t is recorded else None) for t in trials]
    results = []
    with contextlib.ExitStack() as pool:
        each: Iterable[TrialResult] = (_one(*task) for task in tasks)
        if processes > 1:
            with signals_deferred():
                spawn, others = multiprocessing.get_context("spawn"), active_children()
                workers = ProcessPoolExecutor(processes, spawn, _end_with_parent)
                pool.enter_context(workers)
                each = workers.map(_one_of_pool, *zip(*tasks, strict=True))
                pool.callback(workers.shutdown, cancel_futures=True)
                begun = [p for p in active_children() if p not in others]
                pool.push(partial(_stop, begun))
        waiting = iter(each)
        for trial in trials:
            say(f"{trial.comparator}, round trip {1e3 * trial.round_trip:.0f} ms")
            results.append(next(waiting))
    return results


def _stop(workers: list[BaseProcess], failed: object, *_: object) -> None:
    """After an interrupt or another error no trial is waited for."""
    for worker in workers if failed else []:
        worker.terminate()


def _end_with_parent() -> None:
    """End this process with its parent, whatever ends that.

    An interrupt of the terminal is the parent's.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    parent = multiprocessing.parent_process()
    assert parent is not None

    def wait() -> None:
        parent.join()
        os._exit(1)

    threading.Thread(target=wait, daemon=True).start()


def _one_of_pool(trial: Trial, recording: Path | None) -> TrialResult:
    """A trial in a process of its own; its recording is cleaned up when it is ended."""
    try:
        signal.signal(signal.SIGTERM, lambda *_: sys.exit(1))
        return _one(trial, recording)
    except SystemExit:  # the pool would take it for a result, and go on to the next
        os._exit(1)
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _one(trial: Trial, recording: Path | None) -> TrialResult:
    if recording is None:
        return run(trial)
    with Recorder(recording) as recorder:
        return run(trial, recorder.watch)


def comparison(results: Sequence[TrialResult]) -> Table:
    """A row for every session."""
    header = (
        *("feedback", "round trip [ms]", "error [N]", "largest force [N]"),
        *("energy given [J]", "largest step [N/ms]", "packets/s", "kbit/s", ""),
    )
    rows = [
        (
            one.trial.comparator,
            f"{1e3 * one.trial.round_trip:.0f}",
            "–" if math.isnan(one.error) else f"{one.error:.2f}",
            f"{one.largest:.1f}",
            f"{one.energy:.3f}",
            f"{one.step:.3f}",
            f"{one.packets:.0f}",
            f"{1e-3 * one.bits:.0f}",
            one.stopped or ("active" if one.energy > ACTIVE else "passive"),
        )
        for one in results
    ]
    return Table(header, rows)


def live_picture(sessions: Sequence[TrialResult]) -> Figure:
    """Felt and true force, a row a comparator, a column a round trip."""
    names = list(dict.fromkeys(s.trial.comparator for s in sessions))
    trips = sorted({s.trial.round_trip for s in sessions})
    with look():
        figure = new_figure(3.6 * len(trips), 1.5 * len(names) + 0.7)
        axes = figure.subplots(
            len(names), len(trips), sharex=True, sharey=True, squeeze=False
        )
        for session in sessions:
            row = names.index(session.trial.comparator)
            ax = axes[row, trips.index(session.trial.round_trip)]
            ax.fill_between(session.time, session.true, color=MEASURED, label="true")
            ax.plot(session.time, session.felt, color=AFTER, lw=1.0, label="felt")
            trip = 1e3 * session.trial.round_trip
            ax.set_title(
                f"{session.trial.comparator}, {trip:.0f} ms: {session.error:.2f} N"
            )
        for ax in axes[-1]:
            ax.set_xlabel("time [s]")
        for ax in axes[:, 0]:
            ax.set_ylabel("force [N]")
        drawn = axes[0, 0].get_legend_handles_labels()
        figure.legend(*drawn, loc="outside lower center", ncols=2)
    return figure

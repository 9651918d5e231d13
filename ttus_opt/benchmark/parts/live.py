"""Part ``live``: how late the haptic loop is, what a link adds, when contact is felt.

The loop runs in real time in its own process, as in a session: a simulated hand presses
the example's model, and a new field arrives twenty times a second. The link is UDP on
this machine, encrypted, with packets of a session's size at a session's rate. At last a
whole session over that link, delayed, tells when a contact changes what the hand feels.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.parts.base import Column, Part
from ttus_opt.benchmark.progress import Progress
from ttus_opt.benchmark.row import Row, RunSpec
from ttus_opt.benchmark.settings import Settings
from ttus_opt.core.errors import NumericalError
from ttus_opt.scan.surface import Surface

if TYPE_CHECKING:  # needs the extra live
    from ttus_opt.live.real_time import Lateness

#: Length of every measurement [s], and rate of new fields [Hz]
SECONDS, FIELDS = 10.0, 20.0

#: Round trip of the session; goals of a swap: until it begins, after half of that, and
#: from there until nine tenths are felt [s]
TRIP, BEGUN, FELT = 0.2, 0.15, 0.6

#: Packets a second, and their length [bytes]
PACKETS, LENGTH = 100.0, 120


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


class LivePart(Part):
    """The loop and the link, without a case."""

    name = "live"
    title = "The haptic loop and a link in real time"
    legend = (
        "Lateness of 1,000 frames a second in the loop's own process, with a new field "
        "twenty times a second; and the time that packets take there and back over "
        "UDP on this machine. From contact: until a model that knows of it is in the "
        "hand's loop, without the way there; then until nine tenths of it are felt. "
        "Late is beyond a period, or the goals of 150 and 600 ms. Other work on the "
        "machine shows here."
    )
    columns = (
        Column("what", "what"),
        Column("number", "frames"),
        Column("rate [Hz]", "rate", lambda value: f"{value:.2f}"),
        Column("median [ms]", "median", _ms),
        Column("99 % [ms]", "p99", _ms),
        Column("worst [ms]", "worst", _ms),
        Column("late [%]", "late", lambda value: f"{100.0 * value:.2g}"),
    )

    def plan(self, cases: Sequence[CaseSpec], settings: Settings) -> list[RunSpec]:
        """One run, independent of the cases."""
        options = {"seconds": SECONDS}
        return [RunSpec(self.name, None, options, settings.time_limit)]

    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """Loop, then link, then both in a session."""
        seconds = float(spec.options["seconds"])
        begin("haptic loop")
        loop = {"what": "haptic loop", **haptic_loop(seconds).as_dict()}
        begin("link")
        packets = {"what": "UDP there and back", **link(seconds).as_dict()}
        begin("session")
        return [loop, packets, *swaps(seconds)]


def haptic_loop(seconds: float) -> Lateness:
    """Run the loop in its process, and let fields arrive.

    Raises:
        NumericalError: The loop's process died.
    """
    from ttus_opt.live.hand import Hand
    from ttus_opt.live.haptic_process import HapticProcess, LoopPlan
    from ttus_opt.live.model_codec import decode_model
    from ttus_opt.live.real_time import Metronome
    from ttus_opt.live.safety import State
    from ttus_opt.live.subject import MEETING, example_subject
    from ttus_opt.live.trial import prepared
    from ttus_opt.message import decode

    sent, content = prepared()
    who = example_subject()
    seen, shell = decode(sent), who.shell
    assert isinstance(seen, Surface)
    first = decode_model(content, seen, shell).field
    fields = first, replace(first, values=0.9 * first.values)
    hand = partial(Hand, who.examination(), again=MEETING)
    with HapticProcess(LoopPlan(shell, hand)) as process:
        process.begin(first)
        while process.frames == 0 and process.alive:
            process.tell(0.0, State.NORMAL)
            time.sleep(0.01)
        for k, _ in enumerate(Metronome(FIELDS, seconds)):
            process.tell(0.0, State.NORMAL)
            process.update(fields[k % 2])
    if process.lateness is None:
        raise NumericalError("the haptic loop's process died")
    return process.lateness


def link(seconds: float) -> Lateness:
    """Send packets to and fro; their times as a lateness."""
    from ttus_opt.live.peer import Outgoing
    from ttus_opt.live.real_time import Lateness, Metronome
    from ttus_opt.live.sealing import new_key
    from ttus_opt.live.socket_link import SocketLink

    key = new_key()
    there = SocketLink(key, "127.0.0.1", 0, calls=False)
    here = SocketLink(key, "127.0.0.1", there.port, calls=True)
    took: list[float] = []
    for number, now in enumerate(Metronome(PACKETS, seconds)):
        data = number.to_bytes(LENGTH, "little")
        here.send(now, [Outgoing(data)])
        end = now + 0.9 / PACKETS
        while time.monotonic() < end:
            arrived = there.receive(time.monotonic())
            there.send(time.monotonic(), [Outgoing(one) for one in arrived])
            if data in here.receive(time.monotonic()):
                took.append(time.monotonic() - now)
                break
    here.close()
    there.close()
    return Lateness.of(took, 1.0 / PACKETS)


def swaps(seconds: float) -> list[Row]:
    """A session's swaps: until they begin, and until they are felt.

    Raises:
        NumericalError: A side died.
    """
    from ttus_opt.live.real_time import Lateness
    from ttus_opt.live.swap_times import measure

    found = measure(seconds, TRIP)
    return [
        {
            "what": what,
            **Lateness.of(times, goal).as_dict(),
            "rate": len(times) / seconds,
        }
        for what, times, goal in (
            ("contact to model", found.begun, BEGUN),
            ("model to nine tenths felt", found.felt, FELT),
        )
    ]


PART = LivePart()

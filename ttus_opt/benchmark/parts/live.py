"""Part ``live``: how late the haptic loop is, what a link adds, when contact is felt.

The loop runs in real time in its own process, as in a session: a simulated hand presses
the example's model, and a new field arrives twenty times a second. The link is UDP on
this machine, encrypted, with packets of a session's size at twice a session's rate;
then WebRTC, once more over a network that is slow and loses packets. At last a whole
session over UDP, delayed, tells when a contact changes what the hand feels.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import asdict, replace
from typing import TYPE_CHECKING, Any

from ttus_opt.benchmark.cases import CaseSpec
from ttus_opt.benchmark.machine import Progress
from ttus_opt.benchmark.parts.base import Column, Part
from ttus_opt.benchmark.row import Row, RunSpec, Settings
from ttus_opt.core.errors import NumericalError

if TYPE_CHECKING:  # needs the extra live
    from ttus_opt.live.real_time import Lateness, Link

#: Length of every measurement [s], and rate of new fields [Hz]
SECONDS, FIELDS = 10.0, 20.0

#: Round trip of the session; goals of a swap: until it begins, after half of that, and
#: from there until nine tenths are felt; of a first model until it is rendered; of the
#: button, a frame of the operator's loop and one of the haptic loop [s]
TRIP, BEGUN, FELT, RENDERED, STOPPED = 0.2, 0.15, 0.6, 0.5, 0.006

#: Packets a second, and their length [bytes]
PACKETS, LENGTH = 100.0, 120

#: Goal of WebRTC beyond the round trip [s]; share of packets that are lost each way
#: where it is slow [–]; time in which it connects [s]
BEYOND, LOST, MEET = 0.05, 0.01, 60.0

#: Time between looks, in which the threads of WebRTC run [s]
PAUSE = 1e-4


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.3g}"


class LivePart(Part):
    """The loop and the link, without a case."""

    name = "live"
    title = "The haptic loop and a link in real time"
    legend = (
        "Lateness of 1,000 frames a second in the loop's own process, with a new field "
        "twenty times a second; and the time that packets take there and back on this "
        "machine: over UDP, over WebRTC, and over WebRTC beyond a round trip of 200 or "
        "500 ms with 1 % lost each way. From contact: until a model that knows of it "
        "is in the hand's loop, without the way there; then until nine tenths of it "
        "are felt; from the first model's arrival to its first frame; from the button "
        "to the first frame that lets go. Late is beyond a period, or the goals of 50 "
        "ms by WebRTC, 150 and 600 ms, 500 ms, 6 ms. Other work on the machine shows "
        "here."
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
        """A run for each measurement, independent of the cases."""
        each = ({"what": what, "seconds": SECONDS} for what in MEASUREMENTS)
        return [RunSpec(self.name, None, one, settings.time_limit) for one in each]

    def measure(self, spec: RunSpec, begin: Progress) -> list[Row]:
        """One of `MEASUREMENTS`."""
        what = str(spec.options["what"])
        begin(what)
        return MEASUREMENTS[what](float(spec.options["seconds"]))


def haptic_loop(seconds: float) -> Lateness:
    """Run the loop in its process, and let fields arrive.

    Raises:
        NumericalError: The loop's process died.
    """
    from ttus_opt.live.haptic_process import HapticProcess, LoopPlan
    from ttus_opt.live.model import LiveModel, ModelPlan
    from ttus_opt.live.real_time import Metronome
    from ttus_opt.live.safety import State
    from ttus_opt.live.subject import example_subject

    who = example_subject()
    first = LiveModel(who.surface, who.shell, ModelPlan()).field
    fields = first, replace(first, values=0.9 * first.values)
    with HapticProcess(LoopPlan(who.shell, who.device())) as process:
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


def udp(seconds: float) -> Lateness:
    """Send packets to and fro over UDP; their times as a lateness."""
    from ttus_opt.live.real_time import Lateness
    from ttus_opt.live.socket_link import SocketLink

    return Lateness.of(between(SocketLink, seconds), 1.0 / PACKETS)


def webrtc(seconds: float, trip: float) -> Row:
    """The same over WebRTC, beyond a round trip [s]; where that is not 0, `LOST` too.

    Raises:
        MissingPackageError: aiortc is not installed.
        NumericalError: The two sides did not connect.
    """
    from ttus_opt.live.impairment import Impairment
    from ttus_opt.live.real_time import Lateness
    from ttus_opt.live.webrtc_link import WebRTCLink

    def make(*given: Any, calls: bool) -> WebRTCLink:
        way = Impairment(0.5 * trip, loss=LOST, seed=2 if calls else 1)
        return WebRTCLink(*given, calls=calls, impairment=way if trip else None)

    took = between(make, seconds, PAUSE)
    found = Lateness.of([one - trip for one in took], BEYOND)
    return {**asdict(found), "rate": len(took) / seconds}


def between(
    make: Callable[..., Any], seconds: float, pause: float = 0.0
) -> list[float]:
    """`echoes` between two sides of a link on this machine [s]."""
    from ttus_opt.live.sealing import new_key

    at = new_key(), "127.0.0.1"
    with (
        closing(make(*at, 0, calls=False)) as there,
        closing(make(*at, there.port, calls=True)) as here,
    ):
        return echoes(here, there, seconds, pause)


def echoes(here: Link, there: Link, seconds: float, pause: float = 0.0) -> list[float]:
    """Times that packets take there and back, from the first that does [s].

    Raises:
        NumericalError: None came back for `MEET`.
    """
    from ttus_opt.live.peer import Outgoing
    from ttus_opt.live.real_time import Metronome

    def looked(now: float) -> list[bytes]:
        arrived = there.receive(now)
        there.send(now, tuple(Outgoing(one) for one in arrived))
        if pause:
            time.sleep(pause)
        return here.receive(now)

    first = time.monotonic()
    while not looked(now := time.monotonic()):
        here.send(now, (Outgoing(bytes(LENGTH)),))
        if now > first + MEET:
            raise NumericalError("the two sides of a link did not meet")
        time.sleep(1.0 / PACKETS)
    sent: dict[bytes, float] = {}
    took: list[float] = []
    for number, now in enumerate(Metronome(PACKETS, seconds), start=1):
        data = number.to_bytes(LENGTH, "little")
        sent[data] = now
        here.send(now, (Outgoing(data),))
        while time.monotonic() < now + 0.9 / PACKETS:
            arrived = [one for one in looked(time.monotonic()) if one in sent]
            took += [time.monotonic() - sent.pop(one) for one in arrived]
    return took


def swaps(seconds: float) -> list[Row]:
    """A session's swaps, its first model, and its stop.

    Raises:
        NumericalError: A side died.
    """
    from ttus_opt.live.real_time import Lateness, promptly
    from ttus_opt.live.swap_times import measure

    promptly()
    found = measure(seconds, TRIP)
    return [
        {
            "what": what,
            **asdict(Lateness.of(times, goal)),
            "rate": len(times) / seconds,
        }
        for what, times, goal in (
            ("contact to model", found.begun, BEGUN),
            ("model to nine tenths felt", found.felt, FELT),
            ("first model to rendering", [found.rendered], RENDERED),
            ("button to stopped hand", [found.stopped], STOPPED),
        )
    ]


#: What is measured, by name; `swaps` names its rows itself
MEASUREMENTS: dict[str, Callable[[float], list[Row]]] = {
    "haptic loop": lambda seconds: [asdict(haptic_loop(seconds))],
    "UDP there and back": lambda seconds: [asdict(udp(seconds))],
    "WebRTC there and back": lambda seconds: [webrtc(seconds, 0.0)],
    "WebRTC beyond 200 ms": lambda seconds: [webrtc(seconds, 0.2)],
    "WebRTC beyond 500 ms": lambda seconds: [webrtc(seconds, 0.5)],
    "session": swaps,
}

PART = LivePart()

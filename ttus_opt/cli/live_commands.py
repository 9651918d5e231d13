"""``ttus-opt live``: sessions over a link, simulated, in real time, and recorded."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Callable
from contextlib import ExitStack, closing
from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ttus_opt.cli.console import Stages, fitted, tell, to_machine
from ttus_opt.core.errors import InputError
from ttus_opt.core.optional import load
from ttus_opt.example import PROBE

if TYPE_CHECKING:  # needs the extra live
    from ttus_opt.live.subject import Subject

#: Port that sessions use unless told otherwise
PORT = 7411

#: Round trip from which WebRTC pauses where packets are lost [s], and what to do
LONG = 0.8
STALLS = (
    f"WebRTC pauses where packets are lost over a round trip of {LONG:g} s or more: "
    "use --link udp there"
)

#: How a probe is held: its axes into the patient, and to the head
HELD = "z,-y"


def demo(
    output: Path = Path("live"),
    prior: float = 1.6,
    loss: float = 0.02,
    no_page: bool = False,
) -> None:
    """Compare four kinds of feedback on a simulated patient, in virtual time.

    Then, in a terminal and where the viewer is installed, a page opens in which the
    session is felt, see ttus-opt live page; Ctrl-C ends it. Not a medical device.

    Args:
        output: Folder for report, picture and a recorded session.
        loss: Share of lost packets, in bursts of three.
        no_page: Open no page.

    Example:
        ttus-opt live demo -o live
    """
    from importlib.util import find_spec

    from ttus_opt.core.threads import usable_cores
    from ttus_opt.live.demo import N_SESSIONS, run_demo

    at_once = min(usable_cores(), N_SESSIONS // 2)
    with Stages(N_SESSIONS) as begin:
        found = run_demo(
            output, prior=prior, loss=loss, processes=at_once, progress=begin
        )
    line = f"{found.seconds:.0f} s; report.html, live.png and session.mcap in {output}/"
    tell(found.as_dict(), fitted(found.table), "", line)
    if not (no_page or to_machine()) and sys.stdout.isatty() and find_spec("viser"):
        page(prior=prior)


def page(
    delay: float = 200.0,
    prior: float = 1.6,
    surface: Path | None = None,
    probe: str = PROBE,
    probe_axes: str = HELD,
    port: int = 8050,
    no_browser: bool = False,
) -> None:
    """Show a simulated session in the browser, with sliders and the stop button.

    A simulated hand presses, or the probe is dragged. Only this machine can open the
    page, by the link that is printed. Ctrl-C ends it. Not a medical device.

    Args:
        delay: Round trip at first [ms].
        surface: Skin (.nc) with made-up tissue below it; by default the example.
        probe: ellipsoid:a,b,c [m] or a mesh [mm].
        probe_axes: Its axes that point into the patient and to the head.

    Example:
        ttus-opt live page --surface torso.nc --probe probe.stl --probe-axes=-y,z
    """
    from ttus_opt.cli.view_command import open_browser
    from ttus_opt.live.trial import Trial
    from ttus_opt.probe.mesh import read_mesh
    from ttus_opt.viewer.live_page import LivePage

    trial = Trial(round_trip=1e-3 * delay, prior=prior)
    mesh = None if ":" in probe else read_mesh(probe, unit="mm")
    with LivePage(
        trial, _subject(surface, probe, probe_axes), mesh=mesh, port=port
    ) as shown:
        url = shown.viewer.url
        tell({"url": url}, url, "open this link; Ctrl-C ends it")
        sys.stdout.flush()
        if not no_browser:
            open_browser(url)
        try:
            shown.viewer.wait()
        except KeyboardInterrupt:
            return


def report(
    delay: float = 1000.0,
    loss: float = 0.0,
    jitter: float = 0.0,
    prior: float = 1.0,
    friction: float = 0.0,
    breathing: float = 0.0,
    no_camera: bool = False,
    comparator: str = "model",
    seconds: float = 20.0,
    seed: int = 0,
    picture: Path | None = None,
    recording: Path | None = None,
) -> None:
    """Simulate one session in virtual time and report what the hand felt.

    Not a medical device.

    Args:
        delay: Round trip [ms].
        loss: Share of lost packets, in bursts of three.
        jitter: Largest further delay of a packet [ms].
        friction: Coulomb coefficient of the skin.
        breathing: Amplitude of the skin's motion [mm].
        no_camera: The follower does not see that motion.
        comparator: What the hand feels: model, fixed, direct or passive.
        seed: Of noise, loss and jitter.
        picture: Draw felt and true force here.
        recording: Record the session here (.mcap).

    Example:
        ttus-opt live report --delay 1000 --loss 0.05 --prior 2 --picture felt.png
    """
    from ttus_opt.live.demo import comparison, live_picture
    from ttus_opt.live.recording import Description, Recorder
    from ttus_opt.live.trial import Trial, run
    from ttus_opt.report.plots.canvas import save_picture

    trial = Trial(
        comparator,
        1e-3 * delay,
        prior,
        loss,
        3.0 if loss else 1.0,
        1e-3 * jitter,
        friction,
        1e-3 * breathing,
        not no_camera,
        seconds=seconds,
        seed=seed,
    )
    with ExitStack() as files, Stages(1) as begin:
        begin("session in virtual time")
        watch = None
        if recording is not None:
            described = Description(comparator=comparator)
            watch = files.enter_context(Recorder(recording, described)).watch
        found = run(trial, watch)
    if picture is not None:
        save_picture(live_picture([found]), picture)
    lines = [fitted(comparison([found]))]
    if math.isnan(found.error):
        lines.append(
            f"no error: it counts in contact, from {trial.settled:g} s on; take more "
            "--seconds"
        )
    tell(found.as_dict(), *lines)


def replay(recording: Path) -> None:
    """Render a recorded session again and compare every force bit by bit.

    Args:
        recording: File of ttus-opt live (.mcap).

    Example:
        ttus-opt live replay --recording live/session.mcap
    """
    from ttus_opt.live.replay import replay as rendered

    found = rendered(recording)
    line = f"{found.identical} of {found.frames} frames are identical bit by bit"
    if found.identical < found.frames:
        line += f"; the others differ by up to {found.largest_difference:.2g} N"
    tell(asdict(found), line)


def key(output: Path) -> None:
    """Make a session key, which operator and follower share.

    Args:
        output: File of the key, readable by its owner only.

    Example:
        ttus-opt live key -o session.key
    """
    from ttus_opt.live.sealing import write_key

    write_key(output)
    tell({"key": str(output)}, f"{output}: give it to both sides")


def follower(
    key: Path,
    host: str = "127.0.0.1",
    port: int = PORT,
    link: str = "udp",
    prior: float = 1.6,
    friction: float = 0.0,
    recording: Path | None = None,
    surface: Path | None = None,
    probe: str = PROBE,
    seconds: float = math.inf,
) -> None:
    """Be the patient's side of a link, with a simulated patient or a recording.

    A recording plays in time once the operator has its model: it obeys no pose, and
    the operator feels what is learned from it. Not a medical device. A robot takes the
    patient's place in Python, see docs/how-to/live.md.

    Args:
        key: Session key, of ttus-opt live key.
        host: Own address to wait at; 0.0.0.0 for every one.
        port: UDP and TCP port; by WebRTC TCP alone, UDP ports are agreed on.
        link: udp, or webrtc (extra webrtc), on both sides.
        friction: Coulomb coefficient of the simulated skin.
        recording: Recording (.csv) with force and torque that plays in time.
        surface: Skin (.nc), by default the example's; without a recording made-up
            tissue lies below it.
        probe: ellipsoid:a,b,c [m] or a mesh [mm]; the operator's as well.

    Example:
        ttus-opt live follower --key session.key --recording press_fit.csv
    """
    from ttus_opt.live.follower import Follower
    from ttus_opt.live.links import open_link
    from ttus_opt.live.model import USUAL_LAW
    from ttus_opt.live.patient import Patient, RecordedPatient
    from ttus_opt.live.real_time import promptly, run_follower
    from ttus_opt.live.safety import State
    from ttus_opt.live.subject import example_subject
    from ttus_opt.live.tissue import TORSO_LAW
    from ttus_opt.live.trial import Trial, prepared, simulated_patient, warm_up
    from ttus_opt.probe.trajectory import read_trajectory

    secret = _checked(link, key, port, seconds)
    given = _subject(surface, probe, HELD)
    who = given or example_subject()
    law = TORSO_LAW if recording is None else USUAL_LAW
    content = prepared(prior, law, who.surface, who.shell)
    side, start = Follower(int(time.time()), who.surface, content), who.start
    patient: Patient
    if recording is None:
        patient = simulated_patient(Trial(friction=friction), given)
    else:
        played, safety = read_trajectory(recording), side.peer.safety
        patient = RecordedPatient(played, lambda: safety.state is State.NORMAL)
        start = played.rotation[0], played.position[0]
    warm_up()
    promptly()
    say = _say("follower", link, side.peer)
    with closing(open_link(link, secret, host, port, calls=False)) as opened:
        ended = run_follower(side, opened, patient, *start, seconds=seconds, tell=say)
    _tell_end("follower", ended, side.peer)


def operator(
    key: Path,
    host: str = "127.0.0.1",
    port: int = PORT,
    link: str = "udp",
    seconds: float = 20.0,
    surface: Path | None = None,
    probe: str = PROBE,
    probe_axes: str = HELD,
    recording: Path | None = None,
) -> None:
    """Be the operator's side of a link, with a simulated hand that presses.

    Not a medical device. A haptic device takes the hand's place in Python, see
    docs/how-to/live.md.

    Args:
        key: Session key, of ttus-opt live key.
        host: Address of the follower.
        port: Its UDP and TCP port.
        link: udp, or webrtc (extra webrtc), on both sides.
        surface: Skin (.nc) that the simulated hand presses, the follower's; by default
            the example's.
        probe: The follower's probe, ellipsoid:a,b,c [m] or a mesh [mm].
        probe_axes: Its axes that point into the patient and to the head.
        recording: Record the session here (.mcap), with every frame that was felt.

    Example:
        ttus-opt live operator --key session.key --host 192.0.2.7 --link webrtc
    """
    from ttus_opt.live.haptic_process import HapticProcess, LoopPlan
    from ttus_opt.live.links import open_link
    from ttus_opt.live.operator import Operator
    from ttus_opt.live.real_time import promptly, run_operator
    from ttus_opt.live.subject import example_subject
    from ttus_opt.live.trial import warm_up

    secret = _checked(link, key, port, seconds)
    who = _subject(surface, probe, probe_axes) or example_subject()
    shell, epoch, record = who.shell, int(time.time()), None
    warm_up()
    with ExitStack() as opened:
        network = open_link(link, secret, host, port, calls=True)
        opened.enter_context(closing(network))
        if recording is not None:
            from ttus_opt.live.recording import Description, Recorder

            told = Description(probe, len(shell), epoch=epoch, apart=True)
            record = opened.enter_context(Recorder(recording, told)).operated
        loop = opened.enter_context(HapticProcess(LoopPlan(shell, who.device())))
        side = Operator(epoch, shell, feedback=lambda model: loop.begin(model.field))
        promptly()
        ended = run_operator(
            side,
            network,
            who.start,
            seconds=seconds,
            record=record,
            tell=_say("operator", link, side.peer),
        )
    ended = replace(ended, lateness=loop.lateness or ended.lateness)
    _tell_end("operator", ended, side.peer, side.view(side.peer.now).as_dict())


def _say(name: str, link: str, peer: Any) -> Callable[[str, str], None]:
    """Says on stderr what state a side is in, and once what may stop it."""
    import typer

    warned = link != "webrtc"

    def say(state: str, cause: str) -> None:
        nonlocal warned
        typer.echo(f"{name}: {state}" + (f" ({cause})" if cause else ""), err=True)
        trip = peer.quality.round_trip
        if not warned and trip >= LONG:
            warned = True
            typer.echo(f"{name}: the round trip is {trip:.1f} s. {STALLS}", err=True)

    return say


def _tell_end(
    name: str, ended: Any, peer: Any, view: dict[str, Any] | None = None
) -> None:
    """How a side's loop ended."""
    late, cause = ended.lateness, f" ({ended.cause})" if ended.cause else ""
    quality = peer.quality
    facts = {
        **asdict(ended),
        "round_trip_s": quality.round_trip,
        "loss": quality.loss,
        "packets_sent": peer.rate.sent_packets,
        "bytes_sent": peer.rate.sent_bytes,
        "refused": peer.refused,
    }
    if view is not None:
        facts["last_view"] = view
    tell(
        facts,
        f"{name}: {ended.state}{cause}; {late.frames} frames at {late.rate:.1f} Hz, "
        f"99 % within {1e3 * late.p99:.2f} ms, {100 * late.late:.2f} % late; round "
        f"trip {1e3 * quality.round_trip:.1f} ms",
    )


def _subject(surface: Path | None, probe: str, probe_axes: str) -> Subject | None:
    """Who is examined with what; None for the example."""
    from ttus_opt.live.subject import Subject, patient_surface, shell_of
    from ttus_opt.probe.held import hold
    from ttus_opt.scan.surface import Surface

    if surface is None and probe == PROBE:
        return None
    into, _, head = probe_axes.partition(",")
    held = hold((into.strip(), head.strip()))
    skin = patient_surface() if surface is None else Surface.load(surface)
    return Subject(skin, shell_of(probe), held)


def _checked(link: str, key: Path, port: int, seconds: float) -> bytes:
    """The session's key, once it is sure that the link can be opened."""
    from ttus_opt.live.links import LINKS
    from ttus_opt.live.sealing import read_key

    if link not in LINKS:
        raise InputError(f"--link is {' or '.join(LINKS)}, got {link}")
    if not 1 <= port <= 65535:
        raise InputError(f"--port is a number from 1 to 65535, got {port}")
    if not seconds > 0.0:
        raise InputError(f"--seconds must be positive [s], got {seconds:g}")
    if link == "webrtc":
        load("aiortc", "webrtc")
    return read_key(key)

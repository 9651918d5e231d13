"""Both sides of a session as commands, each in its process."""

import contextlib
import json
import math
import signal
import time
from pathlib import Path

import pytest

from tests.kit import own_port, python, started
from ttus_opt.cli.live_commands import _say

pytest.importorskip("msgspec", reason="needs ttus-opt[live]")
pytest.importorskip("cryptography", reason="needs ttus-opt[live]")

from ttus_opt.live.peer import Peer

LIVE = "-m", "ttus_opt", "live"


@pytest.mark.slow
@pytest.mark.parametrize("link", ["udp", "webrtc"])
def test_both_commands_meet(link, tmp_path):
    if link == "webrtc":
        pytest.importorskip("aiortc", reason="needs ttus-opt[webrtc]")
    key = tmp_path / "session.key"
    key.write_text(bytes(32).hex())
    key.chmod(0o600)
    words = f"--key {key} --port {own_port()} --link {link} --json --seconds".split()
    follower = started(*LIVE, "follower", *words, "600")
    try:
        assert follower.stderr.readline().startswith("follower: ")  # it is at work
        told = python(*LIVE, "operator", *words, "10")
    finally:
        follower.kill()
        follower.communicate()
    assert "NORMAL" in json.loads(told.stdout)["seen"]


def members(session):
    """Numbers of a session's processes that run."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, _, own = file.read_text().rpartition(")")[2].split()[:4]
            if int(own) == session and state != "Z":
                found.append(int(file.parent.name))
    return found


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="looks in /proc")
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_a_demo_that_is_ended_leaves_no_process(kind, tmp_path):
    demo = started(*LIVE, "demo", "--no-page", "-o", tmp_path / "demo")
    end = time.monotonic() + 60.0
    while len(members(demo.pid)) < 5:  # it, its watch, two workers, their memory's
        assert time.monotonic() < end
        time.sleep(0.1)
    time.sleep(3.0)
    demo.send_signal(kind)
    demo.communicate(timeout=30.0)
    end = time.monotonic() + 10.0
    while left := members(demo.pid):
        assert time.monotonic() < end, left
        time.sleep(0.1)


@pytest.mark.parametrize("link", ["udp", "webrtc"])
def test_a_long_way_over_webrtc_is_warned_of_once(link, capsys):
    peer = Peer(1)
    say = _say("operator", link, peer)
    for trip in (math.nan, 0.5, 0.9, 1.1):
        peer.quality.round_trip = trip
        say("HOLD", "no packet for 100 ms")
        warned = "0.9 s" in (told := capsys.readouterr().err)
        assert warned == ("--link udp" in told) == (link == "webrtc" and trip == 0.9)


@pytest.mark.parametrize(
    ("words", "says"),
    [
        ("--delay=-5", "got -5 ms"),
        ("--breathing 500", "got 500 mm"),
        ("--seconds 2", "no error: it counts in contact, from 10 s on"),
    ],
)
def test_what_a_report_cannot_say(run, words, says):
    told = run(f"live report {words}")
    assert says in told.out + told.err


def test_a_demo_that_is_refused_leaves_no_folder(run, tmp_path):
    assert run(f"live demo -o {tmp_path}/demo --loss 2").status != 0
    assert [*tmp_path.iterdir()] == []

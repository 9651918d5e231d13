"""Both sides of a session as commands, each in its process."""

import json
import socket
import subprocess
import sys

import pytest

from ttus_opt.cli.live_commands import _say

pytest.importorskip("msgspec", reason="needs ttus-opt[live]")
pytest.importorskip("cryptography", reason="needs ttus-opt[live]")


@pytest.mark.slow
@pytest.mark.parametrize("link", ["udp", "webrtc"])
def test_both_commands_meet(link, tmp_path):
    if link == "webrtc":
        pytest.importorskip("aiortc", reason="needs ttus-opt[webrtc]")
    key = tmp_path / "session.key"
    key.write_text(bytes(32).hex())
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    words = [*f"--key {key} --port {port} --link {link} --json --seconds".split()]
    live = [sys.executable, "-m", "ttus_opt", "live"]
    follower = subprocess.Popen(
        [*live, "follower", *words, "60"],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
    )
    try:
        command = [*live, "operator", *words, "10"]
        told = subprocess.run(command, capture_output=True, text=True, timeout=120)
    finally:
        follower.kill()
        follower.wait()
    assert told.returncode == 0, told.stderr
    assert "NORMAL" in json.loads(told.stdout)["seen"]


@pytest.mark.parametrize("link", ["udp", "webrtc"])
def test_a_stop_over_webrtc_names_the_other_link(link, capsys):
    say = _say("operator", link)
    say("HOLD", "no packet for 100 ms")
    say("STOP", "the operator's button")
    assert "udp" not in capsys.readouterr().err
    say("STOP", "no packet for 500 ms")
    assert ("--link udp" in capsys.readouterr().err) == (link == "webrtc")

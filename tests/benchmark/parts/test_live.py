"""The live part measures a loop and a link that run."""

import pytest

pytest.importorskip("msgspec", reason="needs ttus-opt[live]")
pytest.importorskip("cryptography", reason="needs ttus-opt[live]")

from ttus_opt.benchmark.parts.live import PACKETS, haptic_loop, link, webrtc


@pytest.mark.slow
def test_the_loop_beats_a_thousand_times_a_second_for_its_time():
    found = haptic_loop(1.0)
    assert 900 <= found.frames <= 3000
    assert found.p99 <= found.worst


def test_packets_come_back():
    found = link(0.5)
    assert 0 < found.frames <= 0.5 * PACKETS
    assert 0.0 < found.median <= found.p99 <= found.worst


def test_packets_come_back_by_webrtc_beyond_the_round_trip():
    pytest.importorskip("aiortc", reason="needs ttus-opt[webrtc]")
    found = webrtc(1.0, 0.1)
    assert 0 < found["frames"] <= PACKETS
    assert 0.0 < found["median"] <= found["p99"] <= found["worst"]


def test_without_the_package_a_row_says_so(monkeypatch):
    monkeypatch.setattr("ttus_opt.benchmark.parts.live.find_spec", lambda name: None)
    found = webrtc(1.0, 0.0)
    assert "ttus-opt[webrtc]" in found["what"]
    assert found["frames"] == 0

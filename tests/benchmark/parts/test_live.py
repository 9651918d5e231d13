"""The live part measures a loop and a link that run."""

import pytest

pytest.importorskip("msgspec", reason="needs ttus-opt[live]")
pytest.importorskip("cryptography", reason="needs ttus-opt[live]")

from ttus_opt.benchmark import Settings, Suite
from ttus_opt.benchmark.parts import live
from ttus_opt.core.errors import TtusWarning


def test_a_folder_from_before_a_measurement_existed_gets_its_rows(
    monkeypatch, tmp_path
):
    made = []

    def isolated(spec, *_):
        made.append(spec.options["what"])
        return [{"key": spec.key, "status": "measured"}]

    monkeypatch.setattr("ttus_opt.benchmark.suite.run_isolated", isolated)
    fewer = {name: live.MEASUREMENTS[name] for name in list(live.MEASUREMENTS)[:-1]}
    with monkeypatch.context() as before:
        before.setattr(live, "MEASUREMENTS", fewer)
        Suite([], tmp_path, Settings(), ("live",)).run()
    with pytest.warns(TtusWarning, match="of an earlier call"):
        found = Suite([], tmp_path, Settings(), ("live",)).run()
    assert made == list(live.MEASUREMENTS)
    assert len(found["live"]) == len(live.MEASUREMENTS)


@pytest.mark.slow
def test_the_loop_beats_a_thousand_times_a_second_for_its_time():
    found = live.haptic_loop(1.0)
    assert 900 <= found.frames <= 3000
    assert found.p99 <= found.worst


@pytest.mark.slow
def test_packets_come_back():
    found = live.udp(0.5)
    assert 0 < found.frames <= 0.5 * live.PACKETS
    assert 0.0 < found.median <= found.p99 <= found.worst


@pytest.mark.slow
def test_packets_come_back_by_webrtc_beyond_the_round_trip():
    pytest.importorskip("aiortc", reason="needs ttus-opt[webrtc]")
    found = live.webrtc(1.0, 0.1)
    assert 0 < found["frames"] <= live.PACKETS
    assert 0.0 < found["median"] <= found["p99"] <= found["worst"]

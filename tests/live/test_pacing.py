"""Packets between two sides over a way with delay and loss."""

import numpy as np
import pytest

from ttus_opt.live.pacing import HEADER, MOST, NUMBERS, WINDOW, Pacing


def exchange(delay, loss=0.0, seconds=5.0, size=120):
    """Both send whenever they may, every millisecond; (sent, bytes), arrived."""
    rng, sides = np.random.default_rng(0), [Pacing() for _ in range(2)]
    ways, sent, arrived = ([], []), ([], []), ([], [])
    for now in np.arange(0.0, seconds, 1e-3):
        for k, side in enumerate(sides):
            while ways[k] and ways[k][0][0] <= now:
                arrived[k].append(side.unwrap(now, ways[k].pop(0)[1]))
            if now >= side.next:
                data = len(sent[k]).to_bytes(size, "little")
                packet = side.wrap(now, data)
                sent[k].append((now, len(packet)))
                if rng.random() >= loss:
                    ways[1 - k].append((now + delay, packet))
    return sides, sent, arrived


@pytest.mark.parametrize("loss", [0.0, 0.05])
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.25, 0.5])
def test_no_more_than_the_window_is_on_its_way(delay, loss):
    sides, sent, _ = exchange(delay, loss)
    for side, own in zip(sides, sent, strict=True):
        assert 2 * delay <= side.round_trip <= 2 * delay + 0.05
        times, sizes = np.array([one for one in own if one[0] > 2.0]).T
        total = np.concatenate([[0.0], np.cumsum(sizes)])
        away = total[1:] - total[np.searchsorted(times, times - 2 * delay)]
        assert away.max() <= WINDOW + sizes[0]
        longest = max(1 / MOST, sizes[0] / WINDOW * (2 * delay + 0.05))
        assert np.diff(times).max() <= longest + 1.1e-3


def test_packets_arrive_whole():
    _, sent, arrived = exchange(0.01, seconds=1.0)
    numbers = [int.from_bytes(data, "little") for data in arrived[0]]
    assert numbers == [*range(len(numbers))]
    assert len(numbers) >= len(sent[1]) - 3


def test_numbers_begin_again():
    here, there = Pacing(), Pacing()
    for k in range(NUMBERS + 10):
        there.unwrap(0.01 * k, here.wrap(0.01 * k, b"x"))
    here.unwrap(0.01 * k + 0.3, there.wrap(0.0, b"y"))
    assert here.round_trip == pytest.approx(0.3)


def test_a_late_packet_takes_nothing_back():
    here, there = Pacing(), Pacing()
    first, second = here.wrap(0.0, b"a"), here.wrap(0.1, b"b")
    for packet in (second, first):
        there.unwrap(0.2, packet)
    here.unwrap(0.5, there.wrap(0.2, b"c"))
    assert here.round_trip == pytest.approx(0.4)


def test_what_has_no_header_is_empty():
    assert Pacing().unwrap(0.0, bytes(HEADER.size)) == b""

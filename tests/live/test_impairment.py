import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.kit import InputError, refuses
from ttus_opt.live.impairment import ImpairedLink, Impairment
from ttus_opt.live.peer import Outgoing


def through(impairment, count=5000, step=0.02, reliable=False):
    """Arrival time and number of packets sent every step."""
    link, got = ImpairedLink(impairment), []
    for k in range(count):
        link.send(step * k, [Outgoing(k.to_bytes(4, "big") * 25, reliable)])
        got += [(step * k, d) for d in link.receive(step * k)]
    for now in step * count + np.r_[0.0:2.0:1e-3, 2.0:40.0:1e-2]:
        got += [(now, d) for d in link.receive(now)]
    return [(t, int.from_bytes(d[:4], "big")) for t, d in got], link


@pytest.mark.parametrize("loss", [0.6, 0.9])
def test_a_large_loss_is_as_given_in_longer_runs(loss):
    link = ImpairedLink(Impairment(loss=loss))
    link.send(0.0, [Outgoing(b"x")] * 20_000)
    assert link.lost / 20_000 == pytest.approx(loss, abs=0.01)


@pytest.mark.parametrize("burst", [1.0, 4.0])
def test_loss_and_bursts_are_as_given(burst):
    n = 20_000
    got, link = through(Impairment(loss=0.1, burst=burst), count=n, step=0.01)
    numbers = np.array(sorted(number for _, number in got))
    assert link.lost == n - len(numbers)
    assert link.lost / n == pytest.approx(0.1, abs=0.01)
    gaps = np.diff(numbers) - 1
    assert gaps[gaps > 0].mean() == pytest.approx(burst, rel=0.12)


def test_how_often_a_burst_is_long_enough_for_a_stop():
    """15 packets of a thirtieth of a second: docs/how-to/live.md says so."""
    loss, burst, sent, rate = 0.05, 5.0, 200_000, 31.0
    link, length, runs = ImpairedLink(Impairment(loss=loss, burst=burst)), 0, 0
    for _ in range(sent):
        lost = link._loses()
        runs += not lost and length >= 15
        length = length + 1 if lost else 0

    def share(loss, burst):  # of packets that begin such a run
        return loss / burst * (1.0 - 1.0 / burst) ** 14

    assert runs / sent == pytest.approx(share(loss, burst), rel=0.25)
    each = [1.0 / (2.0 * rate * share(0.02, burst)) for burst in (3.0, 2.0)]
    assert np.array(each) / 60.0 == pytest.approx([11.8, 440.0], rel=0.01)


def test_delay_and_jitter():
    got, _ = through(Impairment(delay=0.1, jitter=0.02), count=200)
    late = [t - 0.02 * n for t, n in got]
    assert min(late) >= 0.1 - 1e-9
    assert max(late) <= 0.12 + 0.02 + 1e-9  # looked at every step
    assert len(got) == 200


@settings(max_examples=30)
@given(st.booleans(), st.integers(0, 1000))
def test_order_is_kept_where_asked(in_order, seed):
    given_ = Impairment(delay=0.01, jitter=0.2, in_order=in_order, seed=seed)
    numbers = [n for _, n in through(given_, count=60)[0]]
    assert (numbers == sorted(numbers)) is in_order


@settings(max_examples=30)
@given(st.floats(0.0, 0.6), st.floats(1.0, 8.0), st.integers(0, 1000))
def test_a_stream_loses_nothing_and_keeps_its_order(loss, burst, seed):
    given_ = Impairment(delay=0.05, jitter=0.1, loss=loss, burst=burst, seed=seed)
    numbers = [n for _, n in through(given_, count=20, reliable=True)[0]]
    assert numbers == list(range(20))


def test_rate_limits_and_a_long_queue_is_lost():
    got, link = through(Impairment(rate=20_000.0), count=400)  # 40 kbit/s are sent
    assert link.lost > 100
    sent = [t for t, _ in got]
    assert 800 * len(got) / (sent[-1] - sent[0]) == pytest.approx(20_000, rel=0.05)


def test_duplicates_and_determinism():
    given_ = Impairment(duplicates=0.5, jitter=0.05, seed=4)
    one, two = through(given_, count=200)[0], through(given_, count=200)[0]
    assert one == two
    assert 250 < len(one) < 350


@pytest.mark.parametrize(
    "bad", [{"delay": -1.0}, {"loss": 1.0}, {"burst": 0.5}, {"rate": 0.0}]
)
def test_what_no_link_does(bad):
    refuses(InputError, "", Impairment, **bad)

import numpy as np
import pytest

from ttus_opt.live.peer import LinkQuality, SendRate


def test_offset_is_within_half_of_the_shortest_round_trip():
    rng, quality, apart = np.random.default_rng(0), LinkQuality(), 77.0
    for k in range(100):
        left = 0.02 * k
        there, held, back = rng.uniform(0.05, 0.15), 0.003, rng.uniform(0.05, 0.15)
        sent = left + there + held + apart
        now = left + there + held + back
        quality.echoed(now, left, held, sent)
        assert quality.round_trip == pytest.approx(there + back)
    assert abs(quality.offset - apart) < 0.05


def test_loss_is_the_share_of_missing_numbers():
    quality = LinkQuality()
    assert quality.loss == 0.0
    for k in range(1, 101):
        if k % 4:
            quality.arrived(0.02 * k, k)
            quality.arrived(0.02 * k, k)  # a duplicate changes nothing
    assert quality.loss == pytest.approx(0.25, abs=0.02)


@pytest.mark.parametrize("size", [20, 100, 180])
def test_rate_stays_below_both_limits(size):
    rate, sent = SendRate(), 0
    for ms in range(20_000):
        rate.tick(1e-3 * ms)
        if rate.ready:
            rate.took(size)
            sent += 1
    assert sent <= 50 * 20 + 1
    assert 8 * rate.sent_bytes <= 64_000 * 20 + 8 * 1800
    if size == 20:
        assert sent > 0.95 * 50 * 20

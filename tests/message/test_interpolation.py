"""Prediction: the bound holds, cubics cost nothing, both sides agree to the bit."""

import numpy as np
import pytest

from tests.kit import refuses
from ttus_opt.message.interpolation import (
    WEIGHT,
    Scheme,
    _lagrange,
    _weights,
    differences,
    restored,
)

SCHEMES = [
    Scheme((7,), (False,), (0,)),
    Scheme((8,), (True,), (0,)),
    Scheme((2, 5), (True, False), (1, 0)),
    Scheme((12, 9), (True, False), (1, 0), (1, 2)),
    Scheme((5, 6, 3), (False, True, False), (2, 0, 1), (1, 1, 2, 8)),
    Scheme(
        (5, 6, 3),
        (False, True, False),
        (2, 0, 1),
        sides=np.random.default_rng(0).integers(-1, 2, (5, 6, 3)).astype(np.int8),
    ),
]


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("bound", [1e-6, 1e-3, 0.5, 10.0])
@pytest.mark.parametrize("kind", ["noise", "extremes", "smooth"])
def test_what_is_decoded_is_within_the_bound(scheme, bound, kind):
    rng = np.random.default_rng(np.prod(scheme.shape))
    values = {
        "noise": rng.normal(0.0, 3.0, scheme.shape),
        "extremes": rng.choice([-9.0, 0.0, 9.0], scheme.shape),
        "smooth": np.sin(np.indices(scheme.shape).sum(0) / 3.0),
    }[kind]
    sent, decoded = differences(values, bound, scheme)
    assert sum(len(part) for part in sent) == np.prod(scheme.shape)
    assert np.abs(decoded - values).max() <= bound * (1 + 1e-9)
    back = restored(np.concatenate(sent), bound, scheme)
    np.testing.assert_array_equal(back, decoded)


def test_the_weights_are_those_of_the_textbook():
    sixteenths = [WEIGHT // 16 * part for part in (-1, 9, 9, -1)]
    assert _lagrange((-3, -1, 1, 3)) == sixteenths
    assert _lagrange((-1, 1)) == [WEIGHT // 2, WEIGHT // 2]


def test_the_weights_of_what_may_be_used():
    """Bit i stands for node i; beyond the nodes a straight line through the nearest."""
    quarter = WEIGHT // 4
    table = _weights((-3, -1, 1, 3))
    assert table[0b1111].tolist() == _lagrange((-3, -1, 1, 3))
    assert table[0b0110].tolist() == [0, 2 * quarter, 2 * quarter, 0]
    assert table[0b1101].tolist() == [
        quarter // 2,
        0,
        4 * quarter + quarter // 2,
        -quarter,
    ]
    assert table[0b1100].tolist() == [0, 0, 6 * quarter, -2 * quarter]
    assert table[0b0001].tolist() == [WEIGHT, 0, 0, 0]
    assert not table[0].any()
    assert _weights((1, 3, 5))[0b111].tolist() == [6 * quarter, -2 * quarter, 0]


def test_nodes_of_another_side_predict_nothing():
    """Whatever lies beyond the surface, the same is sent of this side."""
    rng = np.random.default_rng(1)
    r, theta = np.meshgrid(np.arange(12), np.arange(16), indexing="ij")
    sides = np.where(r < 6.5 + 2 * np.cos(theta), 1, -1).astype(np.int8)
    scheme = Scheme((12, 16), (False, True), (0, 1), (1, 2), sides)
    own = np.sin(r / 4.0) * np.cos(theta * np.pi / 8)
    place = np.arange(own.size).reshape(own.shape)
    order = np.concatenate(
        [place[np.ix_(*step.target)].reshape(-1) for step in scheme.passes()]
    )
    inside = (sides == 1).reshape(-1)[order]
    sent = []
    for beyond in (0.0, 50.0, rng.normal(0.0, 9.0, own.shape)):
        values = np.where(sides == 1, own, beyond)
        sent.append(np.concatenate(differences(values, 1e-3, scheme)[0]))
    np.testing.assert_array_equal(sent[0][inside], sent[1][inside])
    np.testing.assert_array_equal(sent[0][inside], sent[2][inside])
    across = Scheme((12, 16), (False, True), (0, 1), (1, 2))
    kink = np.where(sides == 1, own, 0.0)
    assert np.count_nonzero(sent[0]) < 0.8 * np.count_nonzero(
        np.concatenate(differences(kink, 1e-3, across)[0])
    )


def test_inside_the_array_is_known_on_the_surface():
    r = np.arange(17.0)
    sides = np.where(r < 12, 1, 0).astype(np.int8)
    values = np.where(r < 12, (12.0 - r) ** 2, 99.0)
    last = [
        differences(values, 1e-3, Scheme((17,), (False,), (0,), sides=own))[0][-1]
        for own in (sides, -sides)
    ]
    assert not last[0].any()
    assert last[1].any()  # otherwise a straight line through two nodes


def test_a_cubic_is_predicted_without_differences():
    x = np.linspace(-1.0, 1.0, 33)
    scheme = Scheme((33,), (False,), (0,))
    sent, _ = differences(x**3 - x, 1e-3, scheme)
    fine = np.concatenate(sent[-3:])  # predicted from four nodes or more
    assert len(fine) == 28
    assert np.count_nonzero(fine) == 0


def test_a_closed_axis_is_predicted_across_its_seam():
    theta = np.arange(64) * 2 * np.pi / 64
    values = np.cos(theta - 0.1)
    closed, open_ = (
        differences(values, 1e-3, Scheme((64,), (periodic,), (0,)))[0]
        for periodic in (True, False)
    )
    assert np.abs(closed[-1]).sum() == 0
    assert np.abs(np.concatenate(closed)).sum() < np.abs(np.concatenate(open_)).sum()


def test_a_bound_too_small_for_32_bits_is_told():
    scheme = Scheme((4, 4), (True, False), (1, 0))
    refuses(OverflowError, "", differences, np.full((4, 4), 1.0), 1e-10, scheme)
    refuses(OverflowError, "", differences, np.full((4, 4), np.nan), 1e-3, scheme)

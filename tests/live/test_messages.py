import msgspec
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from tests.kit import refuses
from ttus_opt.live.messages import (
    LONGEST,
    LONGEST_DATAGRAM,
    MOST_SAMPLES,
    DamagedError,
    Hello,
    Measurement,
    MessageError,
    NotFiniteError,
    Packet,
    PoseCommand,
    Sample,
    StateReport,
    Stop,
    decode,
    encode,
    measurement,
    pose_command,
    pose_of,
    samples_of,
)


def packet(body=None, **changes):
    numbers = dict(
        epoch=5, sequence=1, sent=100, echo=0, held=0, state=0, stops=0, body=body
    )
    numbers["body"] = StateReport() if body is None else body
    return Packet(**{**numbers, **changes})


def sample(seed=0, **changes):
    rng = np.random.default_rng(seed)
    rotation = Rotation.random(rng=rng).as_matrix()
    whole = Sample(10.0, rotation, rng.uniform(-1, 1, 3), rng.uniform(-5, 5, 6))
    return Sample(**{**vars(whole), **changes})


def test_a_pose_survives_within_float32():
    one = sample(3)
    body = decode(encode(packet(pose_command(one.rotation, one.position)))).body
    rotation, position = pose_of(body)
    np.testing.assert_allclose(rotation, one.rotation, atol=3e-7)
    np.testing.assert_allclose(position, one.position, atol=1e-7)


def test_samples_survive_newest_first():
    sent = [sample(1, time=10.0), sample(2, time=9.98)]
    body = decode(encode(packet(measurement(8, sent, 10.01)))).body
    assert body.index == 8
    for there, here in zip(samples_of(body, 10.01), sent, strict=True):
        assert there.time == pytest.approx(here.time, abs=1e-6)
        np.testing.assert_allclose(there.wrench, here.wrench, atol=1e-6)
        np.testing.assert_allclose(there.rotation, here.rotation, atol=3e-7)


def test_a_packet_of_one_sample_fits_64_kbit_at_50_hz():
    size = len(encode(packet(measurement(2**31, [sample()], 10.0), sent=2**31)))
    assert 50 * 8 * (size + 28 + 32) <= 64_000


def test_most_samples_fit_a_datagram():
    body = measurement(9, [sample(k) for k in range(MOST_SAMPLES)], 10.0)
    assert len(encode(packet(body))) < LONGEST_DATAGRAM


@given(st.binary(max_size=300))
def test_arbitrary_bytes_are_refused(data):
    refuses(MessageError, "", decode, data)


@given(st.binary(max_size=200), st.integers(0, 30))
def test_arbitrary_content_with_a_right_checksum_is_refused_or_a_packet(data, cut):
    import struct
    import zlib

    content = (data + msgspec.msgpack.encode(packet(Hello(1))))[cut:]
    try:
        found = decode(content + struct.pack("<I", zlib.crc32(content)))
    except MessageError:
        return
    assert isinstance(found, Packet)


@given(st.integers(0, 10_000), st.integers(0, 7))
def test_a_flipped_bit_is_damage(place, bit):
    data = bytearray(encode(packet(pose_command(np.eye(3), np.zeros(3)))))
    data[place % len(data)] ^= 1 << bit
    refuses(DamagedError, "", decode, bytes(data))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_is_told_apart(value):
    pose = np.array([0, 0, value, 1, 0, 0, 0], dtype="<f4").tobytes()
    refuses(NotFiniteError, "", decode, encode(packet(PoseCommand(pose))))
    row = np.array([0, 0, 0, 0, 1, 0, 0, 0, value, *np.zeros(5)], dtype="<f4")
    refuses(NotFiniteError, "", decode, encode(packet(Measurement(1, row.tobytes()))))


BAD = [
    packet(PoseCommand(b"1234")),
    packet(PoseCommand(np.array([11, 0, 0, 1, 0, 0, 0], "<f4").tobytes())),
    packet(PoseCommand(np.array([0, 0, 0, 0.9, 0, 0, 0], "<f4").tobytes())),
    packet(PoseCommand(np.zeros(7, "<f4").tobytes())),
    packet(Measurement(1, b"")),
    packet(Measurement(1, bytes(56 * (MOST_SAMPLES + 1)))),
    packet(Measurement(-1, bytes(56))),
    packet(
        Measurement(
            1, np.array([0, 0, 0, 0, 1, 0, 0, 0, 2e3, 0, 0, 0, 0, 0], "<f4").tobytes()
        )
    ),
    packet(Stop("x" * 200)),
    packet(Stop("two\nlines")),
    packet(Hello(1, units="x" * 200)),
    packet(state=3),
    packet(epoch=2**32),
    packet(sequence=-1),
]


@pytest.mark.parametrize("bad", BAD, ids=range(len(BAD)))
def test_values_out_of_range_are_refused(bad):
    refuses(MessageError, "", decode, encode(bad))


def test_too_long_is_refused_before_anything_is_read():
    refuses(MessageError, "at most", decode, bytes(LONGEST + 1))

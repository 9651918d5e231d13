import os

import numpy as np

from tests.kit import FileError, InputError, refuses
from ttus_opt.live.sealing import SealedChannel, new_key, read_key, write_key

KEY = bytes(range(32))


def pair(key=KEY, other=None):
    a = SealedChannel(key, calls=True)
    b = SealedChannel(other or key, calls=False)
    return a, b


def met(**changes):
    a, b = pair(**changes)
    b.open(a.greeting())
    a.open(b.greeting())
    return a, b


def test_both_ways():
    a, b = met()
    assert b.open(a.seal(b"pose")) == b"pose"
    assert a.open(b.seal(b"force")) == b"force"
    assert b"pose" not in a.seal(b"pose")


def test_who_has_another_key_neither_joins_nor_reads():
    a, b = met(other=bytes(32))
    assert not a.ready
    assert not b.ready
    refuses(InputError, "not greeted", a.seal, b"x")


def test_a_packet_opens_once_and_late_ones_open():
    a, b = met()
    sealed = [a.seal(bytes([k])) for k in range(50)]
    assert [b.open(sealed[k]) for k in (0, 49, 3)] == [b"\0", bytes([49]), b"\3"]
    assert [b.open(sealed[k]) for k in (0, 49, 3)] == [None, None, None]


def test_too_late_is_refused():
    a, b = met()
    first = a.seal(b"first")
    for _ in range(1100):
        b.open(a.seal(b"x"))
    assert b.open(first) is None


def test_packets_of_an_earlier_session_do_not_open():
    a, _ = met()
    greeting, old = a.greeting(), a.seal(b"old")
    fresh, again = met()
    assert again.open(old) is None
    again.open(fresh.seal(b"x"))
    again.open(greeting)  # a replayed greeting changes nothing
    assert again.open(old) is None
    assert again.open(fresh.seal(b"still")) == b"still"


def test_a_packet_does_not_open_where_it_came_from_or_for_another_purpose():
    a, _ = met()
    assert a.open(a.seal(b"x")) is None
    stream = SealedChannel(KEY, calls=False, purpose="stream")
    stream.open(a.greeting())
    assert not stream.ready


def test_another_version_is_refused():
    a, b = met()
    sealed = bytearray(a.seal(b"x"))
    sealed[2] = 0
    assert b.open(bytes(sealed)) is None
    greeting = bytearray(a.greeting())
    greeting[2] = 0
    fresh = SealedChannel(KEY, calls=False)
    fresh.open(bytes(greeting))
    assert not fresh.ready


def test_no_nonce_is_used_twice_where_an_old_greeting_is_replayed():
    old, _ = pair()
    a, b = met()
    first = b.seal(b"first")
    b.open(old.greeting())
    b.open(a.greeting())
    second = b.seal(b"second")
    assert first[4:12] != second[4:12]
    assert [a.open(first), a.open(second)] == [b"first", b"second"]


def test_a_side_that_starts_again_is_met_and_who_was_replaced_is_not():
    a, b = met()
    greeting, sealed = a.greeting(), a.seal(b"once")
    assert b.open(sealed) == b"once"
    new = SealedChannel(KEY, calls=True)
    b.open(new.greeting())
    new.open(b.greeting())
    assert b.open(new.seal(b"new")) == b"new"
    b.open(greeting)
    assert b.open(sealed) is None
    assert new.open(b.seal(b"hello")) == b"hello"


def fuzzed(count):
    a, b = met()
    rng, good = np.random.default_rng(0), a.seal(b"x" * 60)
    greeting = a.greeting()
    for k in range(count):
        base = bytearray((good, greeting, os.urandom(90))[k % 3])
        if k % 3 < 2:
            base[rng.integers(len(base))] ^= 1 << rng.integers(8)
            if k % 5 == 0:
                del base[rng.integers(len(base)) :]
        assert b.open(bytes(base)) is None
    assert b.open(good) == b"x" * 60
    assert b.open(a.seal(b"y")) == b"y"


def test_fuzzed_packets_are_refused():
    fuzzed(2000)


def test_key_files(tmp_path, monkeypatch):
    path = tmp_path / "session.key"
    write_key(path)
    assert len(read_key(path)) == 32
    assert path.stat().st_mode & 0o077 == 0
    refuses(FileError, "exists", write_key, path)
    path.chmod(0o600)
    path.write_text("abc")
    refuses(FileError, "live key", read_key, path)
    path.write_text("00" * 16)
    refuses(FileError, "16 bytes", read_key, path)
    for mode in (0o640, 0o604):
        path.chmod(mode)
        told = refuses(FileError, f"mode {mode:o}", read_key, path)
        assert f"chmod 600 {path}" in told
    # another's file, such as a container's secret, is not ours to close
    monkeypatch.setattr(os, "getuid", lambda: path.stat().st_uid + 1)
    refuses(FileError, "16 bytes", read_key, path)
    refuses(InputError, "32 bytes", SealedChannel, b"short", calls=True)
    assert new_key() != new_key()

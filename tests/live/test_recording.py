import json
import struct

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tests.kit import FileError, refuses
from tests.live.springy import BALL, session
from ttus_opt.live.impairment import Impairment
from ttus_opt.live.recording import Description, Frame, Recorder, frames_of
from ttus_opt.live.replay import replay

mcap = pytest.importorskip("mcap.reader", reason="needs mcap")
typesys = pytest.importorskip("rosbags.typesys", reason="needs rosbags")


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    path = tmp_path_factory.mktemp("live") / "session.mcap"
    given = Impairment(delay=0.1, loss=0.1, burst=3, jitter=0.02)
    with Recorder(path, Description(f"sphere:{BALL}", 200)) as recorder:
        moments = []
        for moment in session(given).run(3.0):
            recorder.watch(moment)
            moments.append(moment)
    return path, moments


def test_a_replay_renders_the_same_forces_bit_by_bit(recorded):
    path, moments = recorded
    assert max(np.linalg.norm(m.felt) for m in moments) > 1.0
    found = replay(path)
    assert (found.frames, found.identical) == (3000, 3000)


def test_a_changed_frame_is_noticed(recorded, monkeypatch):
    path, _ = recorded
    description, frames = frames_of(path)
    changed = list(frames)
    k = next(k for k, f in enumerate(changed) if any(np.frombuffer(f.felt)))
    other = np.nextafter(np.frombuffer(changed[k].felt), np.inf).tobytes()
    old = changed[k]
    changed[k] = Frame(old.time, old.pose, old.packets, other)
    monkeypatch.setattr(
        "ttus_opt.live.replay.frames_of", lambda _: (description, iter(changed))
    )
    assert replay(path).identical == 2999


def test_standard_messages_hold_what_was_felt(recorded):
    """As CDR writes them: a stamp, a frame of reference, then all numbers."""
    path, moments = recorded
    with path.open("rb") as stream:
        reader = mcap.make_reader(stream)
        found = [
            (schema.name, channel.topic, message)
            for schema, channel, message in reader.iter_messages(
                topics=["/hand/felt", "/hand/pose"]
            )
        ]
    assert len(found) == 2 * 150
    by_time = {round(1e9 * m.time): m for m in moments}
    for name, topic, message in found:
        moment = by_time[message.log_time]
        encoding, *stamp, length = struct.unpack_from("<4siII", message.data)
        assert encoding == b"\0\1\0\0"
        assert stamp == [*divmod(message.log_time, 10**9)]
        assert message.data[16 : 16 + length] == b"patient\0"
        numbers = np.frombuffer(message.data, "<f8", offset=28)
        if topic == "/hand/felt":
            assert name.endswith("/WrenchStamped")
            np.testing.assert_array_equal(numbers, moment.felt)
        else:
            assert name.endswith("/PoseStamped")
            np.testing.assert_array_equal(numbers[:3], moment.position)
            turn = Rotation.from_quat(numbers[3:]).as_matrix()
            np.testing.assert_allclose(turn, moment.rotation, atol=1e-12)


def test_no_file_is_left_by_a_session_that_failed(tmp_path):
    path = tmp_path / "session.mcap"
    with pytest.raises(RuntimeError), Recorder(path):
        raise RuntimeError
    assert list(tmp_path.iterdir()) == []


def test_no_file_is_left_where_it_could_not_be_completed(tmp_path, monkeypatch):
    def full():
        raise OSError("no space left")

    with pytest.raises(OSError, match="no space"), Recorder(tmp_path / "s.mcap") as r:
        monkeypatch.setattr(r._writer, "finish", full)
    assert list(tmp_path.iterdir()) == []


def test_a_stamp_just_before_a_second_is_that_second(tmp_path):
    with Recorder(tmp_path / "s.mcap") as recorder:
        pose = np.eye(3), np.zeros(3)
        recorder._show(12.9999999999, pose, np.zeros(6), None)
    with (tmp_path / "s.mcap").open("rb") as stream:
        found = [m.data for *_, m in mcap.make_reader(stream).iter_messages()]
    assert [struct.unpack_from("<iI", data, 4) for data in found] == 2 * [(13, 0)]


def test_an_interrupt_completes_the_file(recorded, tmp_path):
    path = tmp_path / "session.mcap"
    simulation = session()
    with pytest.raises(KeyboardInterrupt), Recorder(path) as recorder:
        for moment in simulation.run(0.25):
            recorder.watch(moment)
        raise KeyboardInterrupt
    assert len([*frames_of(path)[1]]) == 250


def test_a_damaged_file_is_refused_whatever_its_codecs_find(recorded, tmp_path):
    whole, path = recorded[0].read_bytes(), tmp_path / "session.mcap"
    rng, refused = np.random.default_rng(0), 0
    for _ in range(12):
        damaged = bytearray(whole)
        for place in rng.integers(0, len(whole) // 2, 3):  # of compressed frames
            damaged[place] ^= 1 << rng.integers(8)
        path.write_bytes(damaged)
        try:
            for _ in frames_of(path)[1]:
                pass
        except FileError as error:
            assert "damaged after" in str(error) or "not a session" in str(error)
            refused += 1
    assert refused == 12


def test_frames_of_another_length_are_refused(recorded, tmp_path, monkeypatch):
    path = tmp_path / "session.mcap"
    monkeypatch.setattr(Recorder, "_write", _short)
    with Recorder(path) as recorder:
        recorder.watch(recorded[1][0])
    refuses(FileError, "another length", replay, path)


def _short(self, now, pose, packets, felt):
    self._block.append(Frame(now, b"", [], felt.tobytes()))


@pytest.mark.parametrize("content", [b"", b"not mcap", struct.pack("<d", 1.0) * 100])
def test_another_file_is_refused(tmp_path, content):
    path = tmp_path / "other.mcap"
    path.write_bytes(content)
    refuses(FileError, "other", replay, path)


def test_a_recording_of_something_else_is_refused(tmp_path):
    from mcap.writer import Writer

    path = tmp_path / "else.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_metadata("other", {"json": json.dumps({})})
        writer.finish()
    refuses(FileError, "not a session", replay, path)

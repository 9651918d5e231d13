"""Whole sessions in virtual time, over links that do what links do."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import InputError, refuses, some
from tests.live.springy import PLAN, Spring, parts, passes, path, session
from ttus_opt.live.follower import Follower
from ttus_opt.live.impairment import Impairment
from ttus_opt.live.messages import (
    MOST_TICKS,
    TICKS,
    VERSION,
    Hello,
    Sample,
    StateReport,
    measurement,
    pose_command,
)
from ttus_opt.live.model import LiveModel, encode_model
from ttus_opt.live.operator import Operator
from ttus_opt.live.peer import Peer
from ttus_opt.live.safety import State
from ttus_opt.message import decode, encode

links = st.builds(
    Impairment,
    delay=st.floats(0.0, 0.5),
    jitter=st.floats(0.0, 0.3),
    in_order=st.booleans(),
    loss=st.floats(0.0, 0.4),
    burst=st.floats(1.0, 20.0),
    duplicates=st.floats(0.0, 0.5),
    rate=st.sampled_from([np.inf, 30_000.0]),
    seed=st.integers(0, 2**16),
)


@pytest.mark.slow
@settings(max_examples=60)
@given(links)
def test_whatever_many_links_do(impairment):
    goes_well(impairment)


def goes_well(impairment):
    simulation, last, stopped = session(impairment), None, [False, False]
    most = simulation.operator.peer.safety.limits.force
    for moment in simulation.run(3.0):
        assert np.isfinite(moment.felt).all()
        assert np.linalg.norm(moment.felt[:3]) <= most
        for side, state in enumerate((moment.operator, moment.follower)):
            assert not (stopped[side] and state is not State.STOP)  # latches
            stopped[side] = state is State.STOP
        if last is not None and moment.operator is not State.STOP:
            step = np.linalg.norm(moment.felt[:3] - last.felt[:3])
            assert step <= 0.5  # N in a millisecond, motion included
        last = moment
    for side in (simulation.operator, simulation.follower):
        assert side.peer.rate.sent_packets <= 50 * 3 + 2
        assert 8 * side.peer.rate.sent_bytes <= 64_000 * 3 + 8 * 2000


def test_a_session_is_the_same_every_time():
    given_ = Impairment(delay=0.1, jitter=0.05, loss=0.1, burst=3, seed=5)
    one, two = (
        [np.concatenate([m.felt, m.position]) for m in session(given_).run(1.0)]
        for _ in range(2)
    )
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


class Soft(Spring):
    """Tissue without friction, of the prior's law and 0.6 of its stiffness."""

    def __init__(self):
        surface, shell, _ = parts()
        self.prior = tt.Renderer(LiveModel(surface, shell, PLAN).field, shell)

    def sense(self, time, rotation, position):
        felt = self.prior.render(rotation, position)
        wrench = 0.6 * np.concatenate([felt.force, felt.torque])
        return Sample(time, rotation.copy(), position.copy(), wrench)


@pytest.mark.parametrize("delay", [0.0, 0.25])
def test_a_clean_link_reaches_normal_and_the_model_learns(delay):
    moved = path(lifted=0.5, period=2.0)
    simulation = session(Impairment(delay=delay), moved=moved, patient=Soft())
    passes(simulation, 3.0)
    view = simulation.operator.view(3.0)
    assert view.state == "NORMAL"
    assert view.folded > 20
    assert view.round_trip == pytest.approx(2 * delay, abs=0.02)
    offset = simulation.operator.peer.quality.offset
    assert offset == pytest.approx(1234.5, abs=0.02)
    errors = []
    for _ in range(8):  # a whole press
        passes(simulation, 0.25)
        view = simulation.operator.view(simulation.time)
        there, measured = np.array(view.felt_there), view.measured.wrench[:3]
        if np.linalg.norm(measured) > 2.0:
            errors.append(np.linalg.norm(there - measured))
    assert len(errors) > 1 and max(errors) < 0.1  # unlearned, 1.5 to 2.2 N


@pytest.mark.slow
def test_a_first_press_into_softer_tissue_is_not_taken_for_friction():
    simulation, learned = session(Impairment(delay=0.25), patient=Soft()), []
    for _ in simulation.run(8.0):
        if simulation.operator.model is not None:
            learned.append(simulation.operator.model.learner.friction)
    assert max(learned) < 0.4
    assert learned[-1] < 0.1


def test_no_force_before_the_hand_was_lifted():
    """A model that arrives in the middle of a press does not push the hand."""
    simulation = session(moved=path(lifted=-2.0))  # it begins deepest
    felt = [np.linalg.norm(m.felt[:3]) for m in simulation.run(1.0)]
    assert max(felt) == 0.0
    assert simulation.operator.feedback is not None
    assert any(np.linalg.norm(m.felt[:3]) > 1.0 for m in simulation.run(4.0))


def deepest():
    """A session in which the hand has just pressed deepest."""
    simulation = session(moved=path(lifted=0.5, period=2.0))
    passes(simulation, 1.5)
    return simulation


def reaches(simulation, state, side, seconds=3.0):
    """Time at which a side reaches a state."""
    for moment in simulation.run(seconds):
        if getattr(moment, side) is state:
            return moment.time
    raise AssertionError(f"never {state.name}")


def test_when_the_operator_dies_the_follower_retracts_then_stops():
    simulation = deepest()
    assert simulation.sensed.wrench[0] > 1.0
    simulation.there.send = lambda now, packets: None  # kill -9
    cut = simulation.time
    assert reaches(simulation, State.HOLD, "follower") - cut <= 0.14
    assert reaches(simulation, State.STOP, "follower") - cut == pytest.approx(
        0.5, abs=0.05
    )
    passes(simulation, 1.0)
    assert np.linalg.norm(simulation.sensed.wrench) < 0.1  # not left pressed


def test_when_the_follower_dies_the_operator_holds_its_model_then_stops():
    simulation = deepest()
    simulation.back.send = lambda now, packets: None
    cut = simulation.time
    assert reaches(simulation, State.HOLD, "operator") - cut <= 0.14
    held = simulation.step()
    assert np.linalg.norm(held.felt[:3]) > 1.0  # the local model stays
    assert "no packet" in simulation.operator.peer.safety.cause
    stop = reaches(simulation, State.STOP, "operator")
    assert stop - cut == pytest.approx(0.5, abs=0.05)
    assert np.linalg.norm([*simulation.run(0.06)][-1].felt) == 0.0


@pytest.mark.parametrize("side", ["operator", "follower"])
def test_the_button_stops_its_side_in_the_same_frame_and_the_other_a_way_later(side):
    simulation = session(Impairment(delay=0.05))
    passes(simulation, 2.0)
    pressed = simulation.time
    getattr(simulation, side).stop()
    own = simulation.step()
    assert getattr(own, side) is State.STOP
    other = "follower" if side == "operator" else "operator"
    assert reaches(simulation, State.STOP, other) - pressed <= 0.05 + 0.021
    assert "button" in getattr(simulation, other).peer.safety.cause


@pytest.mark.parametrize(
    "wrench", [[np.nan, 0, 0, 0, 0, 0], [50.0, 0, 0, 0, 0, 0], [0, 0, 0, 5.0, 0, 0]]
)
def test_an_unusable_measurement_stops_both(wrench):
    simulation = session()
    passes(simulation, 1.0)
    simulation.patient.wrench = wrench
    began = simulation.time
    # in the follower's next frame (100 Hz), and a frame of its own later (200 Hz)
    assert reaches(simulation, State.STOP, "follower", 0.05) - began <= 0.011
    assert reaches(simulation, State.STOP, "operator", 0.05) - began <= 0.021
    passes(simulation, 0.2)
    assert simulation.operator.newest.wrench.max() < 1.0  # and nobody learns from it


def test_a_stop_is_not_kept_waiting_by_what_is_to_be_learned():
    """What came with its cause is learned a frame later, and nothing is lost."""
    simulation = deepest()
    operator, hand, peer = simulation.operator, simulation.hand, Peer(3)
    peer._sequence = 10**6
    sample = replace(simulation.sensed, time=simulation.time + 1234.6)
    news = peer.pack(sample.time, measurement(10**6, [sample], sample.time)).data
    operator.stop()
    before, now = operator.folded, simulation.time
    operator.step(now, [news], hand.rotation, hand.position)
    assert operator.peer.safety.state is State.STOP
    assert operator.folded == before
    operator.step(now + 0.005, [], hand.rotation, hand.position)
    assert operator.folded == before + 1


@pytest.mark.parametrize("turn", [np.nan, 0.0, -1.0, 1.0])
def test_an_invalid_hand_pose_stops(turn):
    simulation = session()
    passes(simulation, 0.5)
    operator, now = simulation.operator, simulation.time + 0.001
    assert operator.feedback is not None
    pose = turn * np.eye(3), np.array([np.nan if turn == 1.0 else 0.11, 0, 0])
    operator.step(now, [], *pose)
    assert operator.peer.safety.state is State.STOP
    np.testing.assert_array_equal(operator.feel(now, *pose), np.zeros(6))


def test_rearming_both_sides_at_zero_contact_goes_on():
    simulation = deepest()
    simulation.operator.stop()
    hand = simulation.hand
    passes(simulation, 0.1)
    with pytest.raises(InputError, match="zero contact"):
        simulation.operator.rearm(hand.rotation, hand.position)
    while hand.position[0] < 0.1205:  # the press ends
        simulation.step()
    force = float(np.linalg.norm(simulation.sensed.wrench[:3]))
    simulation.operator.rearm(hand.rotation, hand.position)
    assert simulation.step().operator is State.HOLD
    simulation.follower.rearm(force)
    assert reaches(simulation, State.NORMAL, "operator", 0.5)
    assert reaches(simulation, State.NORMAL, "follower", 0.5)


@pytest.mark.parametrize("seed", some(range(4), 1))
def test_silence_stops_after_500_ms_and_not_before(seed):
    simulation = session(Impairment(delay=0.1, loss=0.3, burst=10.0, seed=seed))
    heard, operator = 0.0, simulation.operator
    for moment in simulation.run(60.0):
        if moment.packets:
            heard = moment.time
        if moment.operator is State.STOP:
            break
        assert not operator.peer.met or moment.time - heard < 0.5
    cause = operator.peer.safety.cause
    if cause == "no packet for 500 ms":
        assert moment.time - heard == pytest.approx(0.5, abs=1e-6)
    else:  # heard by the other side alone, which then said so
        assert cause == "the other side stopped: no packet for 500 ms"


def test_an_operator_that_starts_again_gets_the_model_again():
    simulation = session()
    passes(simulation, 0.5)
    _, shell, _ = parts()
    simulation.operator = Operator(9, shell)
    assert reaches(simulation, State.NORMAL, "operator", 1.0)
    assert simulation.operator.model is not None


def test_a_follower_that_starts_again_is_obeyed_by_none_and_obeys_again():
    """The operator keeps what it learned: it is offered the same model."""
    simulation = deepest()
    learned = simulation.operator.model
    simulation.follower = Follower(9, *parts()[::2])
    assert reaches(simulation, State.NORMAL, "follower", 0.5)
    assert simulation.operator.model is learned


def test_a_hello_that_is_lost_with_its_stream_is_said_again():
    simulation = session()
    send, until = simulation.there.send, 0.5
    simulation.there.send = lambda now, packets: send(
        now, [p for p in packets if not (p.reliable and now < until and knows())]
    )

    def knows():
        return simulation.operator.model is not None

    assert reaches(simulation, State.NORMAL, "follower", 2.0) >= until
    passes(simulation, 0.1)
    said, pack = [], simulation.operator.peer.pack
    simulation.operator.peer.pack = lambda now, body, **options: (
        said.append(body),
        pack(now, body, **options),
    )[1]
    passes(simulation, 1.0)
    assert not any(isinstance(body, Hello) for body in said)


def test_who_joins_after_a_new_surface_gets_it():
    surface, shell, content = parts()
    simulation = session()
    higher = replace(surface, radius=surface.radius + 0.005)
    change = encode(higher, base=content[0])
    over = encode_model(LiveModel(decode(change, base=content[0]), shell, PLAN))
    passes(simulation, 0.5)
    simulation.back.send(0.5, simulation.follower.renew(1235.0, change, over))
    for epoch in (9, 10):
        simulation.operator = Operator(epoch, shell)
        passes(simulation, 0.5)
        assert simulation.operator.model.surface.radius.max() > 0.104
    assert simulation.follower.surface.radius.max() > 0.104  # the workspace as well


def test_packets_of_a_process_that_was_replaced_are_ignored():
    # the last one's clock was set back before it started
    old, new, last, one = Peer(5), Peer(6), Peer(4), Peer(1)
    order = (old, True), (new, True), (old, False), (last, True), (new, False)
    for sender, counts in order:
        data = sender.pack(0.0, Hello(VERSION)).data
        assert (one.receive(0.0, data) is not None) is counts


def test_a_packet_counts_once_however_often_it_arrives():
    sender, one = Peer(5), Peer(1)
    data = sender.pack(0.0, Hello(VERSION)).data
    assert one.receive(0.0, data) is not None
    assert one.receive(0.1, data) is None
    # what was heard is not renewed by a replay
    assert one.safety.judge(0.55) is State.STOP


def test_a_sample_counts_once_however_late_a_packet_with_it_comes():
    """20 s late at 50 a second, its samples came with others long ago."""
    simulation = session()
    passes(simulation, 1.0)
    sender, operator, hand = Peer(8), simulation.operator, simulation.hand
    samples = [replace(simulation.sensed, time=0.02 * k) for k in range(1001)]
    sent = [
        sender.pack(2.0, measurement(k, samples[k : k - 4 : -1], 2.0)).data
        for k in range(4, 1001)
    ]
    late = sent.pop(50)
    pose = hand.rotation, hand.position
    operator.step(2.0, sent, *pose)
    learned = operator.folded
    operator.step(2.1, [late], *pose)
    assert operator.folded == learned


def test_sides_that_start_in_the_same_second_hear_each_other():
    surface, shell, content = parts()
    sides = Operator(7, shell).peer, Follower(7, surface, content).peer
    for one, other in (sides, sides[::-1]):
        assert other.receive(0.0, one.pack(0.0, StateReport()).data) is not None


def test_a_session_goes_on_when_the_32_bits_of_its_clocks_are_full():
    surface, _, content = parts()
    operator, follower = Peer(9), Follower(3, surface, content)
    full, last, sent = MOST_TICKS / TICKS, 0.0, []
    start, along = np.array([0.13, 0.0, 0.15]), np.array([0.0, 0.0, 1.0])
    for k in range(200):
        now = full - 1.0 + 0.01 * k
        pose = pose_command(np.eye(3), start + 2e-4 * k * along)
        data, follower._ready = [operator.pack(now, pose).data], True
        sensed = Sample(now, np.eye(3), start, np.zeros(6))
        step = follower.step(now + 0.005, data, sensed)
        for packet in step.send:
            _, told = operator.receive(now + 0.01, packet.data)
            assert told > last
            last = told
        sent.append(step.position[2])
    assert sent[-1] == pytest.approx(0.15 + 2e-4 * 199, abs=1e-6)
    assert last == pytest.approx(now + 0.005, abs=0.05)
    for one in (operator, follower.peer):
        assert one.quality.round_trip == pytest.approx(0.01, abs=1e-4)
        assert one.quality.offset == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("hello", "said"),
    [
        (Hello(VERSION + 1), f"version {VERSION + 1}"),
        (Hello(VERSION, units="mm"), "units mm"),
    ],
)
def test_another_version_or_unit_is_refused(hello, said):
    surface, _, content = parts()
    follower, sender = Follower(3, surface, content), Peer(9)
    sensed = Spring().sense(0.0, np.eye(3), np.array([0.2, 0, 0.1]))
    found = follower.step(0.0, [sender.pack(0.0, hello).data], sensed)
    assert found.state is State.STOP
    assert said in found.cause


def test_a_flood_of_damaged_packets_stops():
    simulation = session()
    passes(simulation, 1.0)
    hand, safety = simulation.hand, simulation.operator.peer.safety
    packets = [b"damaged packet"] * 25
    simulation.operator.step(1.0, packets, hand.rotation, hand.position)
    assert safety.state is State.STOP
    assert "damaged" in safety.cause


def commanded(sender, now, rotation, position):
    return [sender.pack(now, pose_command(rotation, position)).data]


class Steered:
    """A follower that knows its operator has the model, and who commands it."""

    def __init__(self):
        surface, _, content = parts()
        self.side, self._sender = Follower(3, surface, content), Peer(9)

    def step(self, now, sensed, *asked, skin=None):
        """A step after a command, if one is asked for: rotation and position."""
        data = commanded(self._sender, now, *asked) if asked else []
        self.side._ready = True
        found = self.side.step(now, data, sensed, skin)
        self.side._ready = True  # the first packet tells of another process
        return found

    def follows(self, asked, at, *, skin=None, frames=1, start=0.0):
        """Its targets where the probe stays at a place."""
        times = start + 0.01 * np.arange(frames)
        return [
            self.step(now, still(now, at), np.eye(3), asked, skin=skin) for now in times
        ]


def still(now, at, rotation=None, wrench=0.0):
    """What a probe senses at a place."""
    turn = np.eye(3) if rotation is None else rotation
    return Sample(now, turn, at, np.full(6, wrench))


AT = np.array([0.13, 0.0, 0.15])


def test_the_follower_turns_no_faster_than_its_limit():
    follower, last, steps = Steered(), np.eye(3), []
    asked = Rotation.from_rotvec([0.0, 2.5, 1.0]).as_matrix()
    for k in range(150):
        found = follower.step(0.01 * k, still(0.01 * k, AT, last), asked, AT)
        steps.append(Rotation.from_matrix(found.rotation @ last.T).magnitude())
        last = found.rotation
    assert max(steps) == pytest.approx(2.0 * 0.01, rel=1e-6)
    # about one axis: it takes no longer than it must
    assert sum(steps) == pytest.approx(np.hypot(2.5, 1.0), rel=1e-5)
    np.testing.assert_allclose(last, asked, atol=1e-6)


@pytest.mark.parametrize(
    ("which", "factor"),
    [("rotation", f) for f in (np.nan, 0.0, -1.0)]
    + [("position", np.nan), ("skin", np.nan), ("skin", 100.0)],
)
def test_a_pose_that_is_not_one_stops_and_moves_nothing(which, factor):
    follower, skin = Steered(), np.array([0.002, 0.0, 0.0])
    before = follower.follows(AT, AT, skin=skin, frames=3)[-1]
    good = {"rotation": np.eye(3), "position": AT, "skin": skin}
    bad = good | {which: factor * good[which]}
    sensed = still(0.03, bad["position"], bad["rotation"])
    found = follower.step(0.03, sensed, skin=bad["skin"])
    assert found.state is State.STOP
    assert "not a " in found.cause
    np.testing.assert_allclose(found.position, before.position, atol=2e-3)
    np.testing.assert_allclose(found.rotation, before.rotation)


def test_retraction_starts_where_the_probe_is_whatever_stopped_it():
    there, asked = np.array([0.115, 0.0, 0.15]), np.array([0.085, 0.0, 0.15])
    for wrench in (0.5, 30.0):  # the button, a limit
        follower = Steered()
        for k in range(40):
            sensed = still(0.01 * k, there, wrench=0.5)
            found = follower.step(0.01 * k, sensed, np.eye(3), asked)
        assert found.position[0] < there[0] - 0.02  # a robot that lags far behind
        if wrench == 0.5:
            follower.side.stop()
        found = follower.step(0.4, still(0.4, there, wrench=wrench))
        assert found.state is State.STOP
        assert there[0] <= found.position[0] < there[0] + 1e-3


def test_a_skin_that_jumps_moves_the_probe_no_faster_than_its_limit():
    follower, skin = Steered(), np.array([0.04, 0.0, 0.0])
    follower.follows(AT, AT, skin=np.zeros(3), frames=5)
    found = follower.follows(AT, AT, skin=skin, frames=3, start=0.05)
    steps = np.diff([AT[0], *(step.position[0] for step in found)])
    assert steps.max() <= 0.25 * 0.01 + 1e-9
    assert steps.min() > 0.0


def test_a_probe_that_was_moved_by_hand_is_followed_from_there():
    follower, moved = Steered(), np.array([0.13, 0.0, 0.25])
    follower.follows(AT, AT, frames=5)
    follower.side.stop()
    follower.follows(AT, AT, frames=5, start=0.05)
    follower.follows(AT, moved, frames=5, start=0.10)
    follower.side.rearm(0.0)
    found = follower.follows(AT, moved, frames=2, start=0.15)
    assert found[-1].state is State.NORMAL
    assert np.linalg.norm(found[-1].position - moved) <= 2 * 0.25 * 0.01 + 1e-9


def test_the_way_to_a_far_command_does_not_lead_through_the_patient():
    at, asked = np.array([0.12, 0.0, 0.15]), np.array([-0.12, 0.02, 0.15])
    found = Steered().follows(asked, at, frames=400)
    radius = [np.hypot(*step.position[:2]) for step in found]
    assert min(radius) >= 0.10 - 0.03 - 1e-4
    steps = np.linalg.norm(np.diff([s.position for s in found], axis=0), axis=1)
    assert steps.max() <= 0.25 * 0.01 + 1e-9


def test_a_first_pose_that_is_not_a_number_is_refused():
    sensed = still(0.0, np.full(3, np.nan))
    refuses(InputError, "tracker", Steered().step, 0.0, sensed)


def test_the_follower_keeps_speed_and_workspace():
    follower, last, inside = Steered(), AT, np.array([0.01, 0.0, 9.0])
    for k in range(400):
        found = follower.step(0.01 * k, still(0.01 * k, last), np.eye(3), inside)
        assert np.linalg.norm(found.position - last) <= 0.25 * 0.01 + 1e-9
        last = found.position
    np.testing.assert_allclose(last, [0.07, 0.0, 0.3], atol=1e-6)


def test_a_new_surface_is_felt_without_a_jump():
    surface, shell, content = parts()
    simulation = session(moved=path(period=20.0))
    passes(simulation, 4.0)
    higher = replace(surface, radius=surface.radius + 0.002)
    change = encode(higher, base=content[0])
    seen = decode(change, base=content[0])
    model = encode_model(LiveModel(seen, shell, PLAN))
    simulation.back.send(4.0, simulation.follower.renew(1238.5, change, model))
    before = simulation.operator.model.learner.touched
    last, steps = None, []
    for moment in simulation.run(1.5):
        if last is not None:
            steps.append(np.linalg.norm(moment.felt[:3] - last))
        last = moment.felt[:3]
    assert simulation.operator.model.surface.radius.max() > 0.1015
    assert simulation.operator.model.learner.touched >= before
    assert simulation.operator.peer.safety.state is State.NORMAL
    assert max(steps) <= 0.05


def test_a_clock_that_goes_back_is_refused():
    simulation = session()
    simulation.step()
    hand = simulation.hand
    with pytest.raises(InputError, match="go back"):
        simulation.operator.step(-1.0, [], hand.rotation, hand.position)
    with pytest.raises(InputError, match="go back"):
        simulation.follower.step(-1.0, [], simulation.sensed)

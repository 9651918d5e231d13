"""One session of the simulated examination, and what it came to.

A hand presses the torso's front three times. What it feels is compared with what the
torso's forces are at the hand's own pose at that moment, which no link can know.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass, field, replace
from functools import cache, partial
from typing import Any

import numpy as np

from ttus_opt import example
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.live.feedback import Feedback, MeasuredForce, PassiveForce
from ttus_opt.live.follower import Follower
from ttus_opt.live.hand import Hand
from ttus_opt.live.impairment import Impairment
from ttus_opt.live.model import LiveModel, ModelPlan
from ttus_opt.live.model_codec import encode_model
from ttus_opt.live.operator import Operator
from ttus_opt.live.patient import Breathing, SimulatedPatient
from ttus_opt.live.simulation import Moment, Simulation
from ttus_opt.live.skin_motion import SkinMotion
from ttus_opt.message import decode, encode
from ttus_opt.phantom.examination import Handling
from ttus_opt.phantom.probe import EllipsoidProbe
from ttus_opt.phantom.torso import Torso
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.terms.depth_profile import DepthProfile
from ttus_opt.scan.surface import Surface

#: What the hand may feel, with a line for tables
COMPARATORS = {
    "model": "this package: a local model that learns",
    "fixed": "a local model that is never updated",
    "direct": "the measured force, delayed",
    "passive": "the same with time-domain passivity control",
}

#: Law of the torso's mean force below this probe, as a fit of its recordings gives it:
#: what a prior's error is counted from
TORSO_LAW = DepthProfile((1.1,), (1.5,))

#: Points of the probe's shell
N_POINTS = 1000

#: Time before the first press, in which both sides meet; of a press [s]
MEETING, PRESS = 2.0, 2.0

#: Age of what a camera tells of the skin [s]; its images a second [Hz]
CAMERA, IMAGES = 0.05, 30.0

#: Places that are pressed in turn [–]
PLACES = 3


@dataclass(frozen=True)
class Trial:
    """What is simulated.

    Attributes:
        comparator: One of `COMPARATORS`.
        round_trip: Of the link [s].
        prior: Factor by which the prior's law is too stiff [–].
        loss: Share of lost packets [–].
        burst: Mean length of a run of lost packets [–].
        jitter: Largest further delay [s].
        friction: Coulomb coefficient of the skin [–].
        breathing: Amplitude of the skin's motion [m].
        camera: Whether the follower sees that motion, `CAMERA` late.
        seconds: Length of the session [s].
        settled: Errors count from here on: each place was pressed, and a round trip of
            a second has passed since [s].
        seed: Of noise and link.
    """

    comparator: str = "model"
    round_trip: float = 0.0
    prior: float = 1.6
    loss: float = 0.0
    burst: float = 1.0
    jitter: float = 0.0
    friction: float = 0.0
    breathing: float = 0.0
    camera: bool = True
    seconds: float = 14.0
    settled: float = 10.0
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse an unknown comparator and values out of range."""
        if self.comparator not in COMPARATORS:
            raise InputError(
                f"unknown comparator {self.comparator!r}: choose from "
                f"{', '.join(COMPARATORS)}"
            )
        for name in ("prior", "seconds"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0.0):
                raise InputError(f"{name} must be positive, got {value}")
        self.impairment()

    def impairment(self) -> Impairment:
        """One direction of the link."""
        return Impairment(
            delay=0.5 * self.round_trip,
            jitter=self.jitter,
            loss=self.loss,
            burst=self.burst,
            seed=self.seed,
        )


@dataclass(frozen=True)
class TrialResult:
    """What a session came to.

    Attributes:
        trial: What was simulated.
        time: Of the frames kept, shape (n,) [s].
        felt: Size of the force that the hand felt, shape (n,) [N].
        true: Size of the torso's force at the hand's pose then, shape (n,) [N].
        error: Mean of their difference in contact, once it has settled [N].
        largest: Largest felt force [N].
        energy: Most energy that the hand had got by any time [J]; a passive patient
            gives none.
        step: Largest change of the felt force in a frame [N].
        stopped: Cause of a STOP; empty without one.
        packets: Datagrams a second, the busier direction [1/s].
        bits: Bits a second with headers, the busier direction [bit/s].
        folded: Measurements learned from [–].
    """

    trial: Trial
    time: Array = field(repr=False)
    felt: Array = field(repr=False)
    true: Array = field(repr=False)
    error: float
    largest: float
    energy: float
    step: float
    stopped: str
    packets: float
    bits: float
    folded: int

    def as_dict(self) -> dict[str, Any]:
        """All figures, without the curves."""
        kept = ("error", "largest", "energy", "step", "packets", "bits")
        units = ("N", "N", "J", "N", "per_s", "per_s")
        figures = {
            f"{name}_{unit}": getattr(self, name)
            for name, unit in zip(kept, units, strict=True)
        }
        told = {"stopped": self.stopped, "folded": self.folded}
        return {**asdict(self.trial), **figures, **told}


@cache
def patient_surface() -> Surface:
    """The example's skin."""
    return Surface.load(example.path("surface.nc"))


@cache
def probe_shell() -> PointShell:
    """The example's probe."""
    return shell_of(example.PROBE)


def shell_of(probe: str) -> PointShell:
    """A probe as `PointShell.from_spec` takes it, with the points of a live session."""
    return PointShell.from_spec(probe, n_points=N_POINTS)


def prepared(
    prior: float = 1.0,
    law: DepthProfile = TORSO_LAW,
    surface: Surface | None = None,
    shell: PointShell | None = None,
) -> tuple[bytes, bytes]:
    """Messages of a surface, and of a prior too stiff by a factor.

    Args:
        prior: The factor [–].
        law: What it is counted from.
        surface: The patient's skin; by default the example's.
        shell: The probe of both sides; by default the example's.
    """
    sent = encode(surface or patient_surface())
    seen = decode(sent)
    assert isinstance(seen, Surface)
    scaled = replace(law, coefficients=(prior * law.coefficients[0],))
    model = LiveModel(seen, shell or probe_shell(), ModelPlan(law=scaled))
    return sent, encode_model(model)


def made_operator(comparator: str, shell: PointShell, epoch: int = 2) -> Operator:
    """An operator whose hand feels one of `COMPARATORS`."""
    kinds: dict[str, Callable[[LiveModel], Feedback]] = {
        "direct": lambda _: MeasuredForce(),
        "passive": lambda _: PassiveForce(),
    }
    learns = comparator == "model"
    return Operator(epoch, shell, feedback=kinds.get(comparator), learns=learns)


def simulation(trial: Trial) -> Simulation:
    """A session that has not begun."""
    operator = made_operator(trial.comparator, probe_shell())
    patient = SimulatedPatient(
        friction=trial.friction,
        breathing=Breathing(trial.breathing),
        seed=trial.seed,
    )
    follower = Follower(3, patient_surface(), prepared(trial.prior))
    hand = Hand(examination(trial.seconds))
    session = Simulation(operator, follower, hand, patient, trial.impairment())
    if trial.camera and trial.breathing:
        session.skin = partial(_seen_skin, SkinMotion(), patient.breathing)
    return session


def _seen_skin(motion: SkinMotion, breathing: Breathing, now: float) -> Array:
    """The skin's displacement as a camera tells it, shape (3,) [m]."""
    image = math.floor((now - CAMERA) * IMAGES) / IMAGES
    motion.see(image, breathing.shift(image))
    return motion.at(now)


def warm_up() -> None:
    """Compile all that a session uses, before its clock runs."""
    session = simulation(Trial(seconds=4.0))
    for _ in session.run(4.0):
        if session.operator.folded > 2:
            session.operator.view(session.time)
            return


def run(trial: Trial, watch: Callable[[Moment], None] | None = None) -> TrialResult:
    """A whole session.

    Args:
        trial: What is simulated.
        watch: Called with every frame.
    """
    session = simulation(trial)
    moments = list(_watched(session, trial.seconds, watch))
    felt = np.array([m.felt[:3] for m in moments])
    place = np.array([m.position for m in moments])
    size = np.linalg.norm(felt, axis=1)
    work = np.sum(0.5 * (felt[1:] + felt[:-1]) * np.diff(place, axis=0), axis=1)
    kept = np.arange(0, len(moments), 20)
    still = SimulatedPatient(noise=0.0)
    true = np.array(
        [
            np.linalg.norm(
                still.wrench(0.0, moments[k].rotation, place[k], np.zeros(3))[:3]
            )
            for k in kept
        ]
    )
    time = np.array([moments[k].time for k in kept])
    counted = (np.maximum(true, size[kept]) > 0.5) & (time > trial.settled)
    difference = np.abs(size[kept] - true)[counted]
    sides = session.operator.peer, session.follower.peer
    return TrialResult(
        trial,
        time,
        size[kept],
        true,
        float(difference.mean()) if counted.any() else math.nan,
        float(size.max()),
        float(np.cumsum(work).max(initial=0.0)),
        float(np.linalg.norm(np.diff(felt, axis=0), axis=1).max()),
        next((s.safety.cause for s in sides if s.safety.state == 2), ""),
        max(s.rate.sent_packets for s in sides) / trial.seconds,
        8.0 * max(s.rate.sent_bytes for s in sides) / trial.seconds,
        session.operator.folded,
    )


def _watched(
    session: Simulation, seconds: float, watch: Callable[[Moment], None] | None
) -> Iterator[Moment]:
    for moment in session.run(seconds):
        if watch is not None:
            watch(moment)
        yield moment


def examination(seconds: float) -> Trajectory:
    """What the hand intends: presses at three places, again and again."""
    time = np.arange(0.0, seconds + 0.05, 0.05)
    phase = np.maximum(time - MEETING, 0.0) / PRESS
    number = phase.astype(int) % PLACES
    depth = -0.006 + 0.026 * np.sin(np.pi * phase) ** 2
    # places change while the probe is lifted
    across = np.array([0.0, 0.008, -0.008])[number]
    along = np.array([0.13, 0.145, 0.14])[number]
    none = np.zeros_like(time)
    handling = Handling(time, across, along, depth, none, none, none)
    return handling.poses(Torso(), EllipsoidProbe((0.030, 0.0125, 0.018)))

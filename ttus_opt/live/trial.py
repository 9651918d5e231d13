"""One session of the simulated examination, and what it came to.

A hand presses the torso's front three times. What it feels is compared with what the
torso's forces are at the hand's own pose at that moment, which no link can know.
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import Any

import numpy as np

from ttus_opt.core.arguments import chosen, expect_not_negative, expect_positive
from ttus_opt.core.arrays import Array
from ttus_opt.core.errors import InputError
from ttus_opt.live.feedback import Feedback, MeasuredForce, PassiveForce
from ttus_opt.live.follower import Follower
from ttus_opt.live.impairment import LONGEST_DELAY, Impairment
from ttus_opt.live.messages import decoded_surface
from ttus_opt.live.model import LiveModel, ModelPlan, encode_model
from ttus_opt.live.operator import Operator
from ttus_opt.live.patient import Breathing, SimulatedPatient, SkinMotion
from ttus_opt.live.simulation import HAPTIC, Moment, Simulation
from ttus_opt.live.subject import (
    MEETING,
    Hand,
    Subject,
    example_subject,
    patient_surface,
    probe_shell,
)
from ttus_opt.live.tissue import TORSO_LAW, ElasticTorso, FieldTissue, Tissue
from ttus_opt.message import encode
from ttus_opt.probe.point_shell import PointShell
from ttus_opt.problem.terms.depth_profile import DepthProfile
from ttus_opt.scan.surface import Surface

#: What the hand may feel, with a line for tables
COMPARATORS = {
    "model": "this package: a local model that learns",
    "fixed": "a local model that is never updated",
    "direct": "the measured force, delayed",
    "passive": "the same with time-domain passivity control",
}

#: Age of what a camera tells of the skin [s]; its images a second [Hz]
CAMERA, IMAGES = 0.05, 30.0

#: Largest amplitude of breathing [m]: five times a quiet breath's
MOST_BREATHING = 0.025

#: Of so many frames one is compared with the truth [–]; most of these that are kept as
#: curves, of a longer session every second, fourth, … [–]
COMPARED, MOST_KEPT = 20, 20_000


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
        chosen([self.comparator], COMPARATORS, "comparator", every="")
        for name in ("prior", "seconds"):
            expect_positive(getattr(self, name), name)
        expect_not_negative(self.seed, "seed")
        if not 0.0 <= self.round_trip <= 2.0 * LONGEST_DELAY:
            raise InputError(
                f"a round trip takes from 0 to {2e3 * LONGEST_DELAY:.0f} ms, got "
                f"{1e3 * self.round_trip:g} ms"
            )
        if not 0.0 <= self.breathing <= MOST_BREATHING:
            raise InputError(
                f"breathing moves skin by 0 to {1e3 * MOST_BREATHING:.0f} mm, got "
                f"{1e3 * self.breathing:g} mm"
            )
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
        true: Size of the torso's force at the hand's pose then, at rest and so without
            friction, shape (n,) [N].
        error: Mean of their difference in contact, once it has settled [N].
        drag_error: The same with the patient's drag at the hand's own velocity [N].
        largest: Largest felt force [N].
        energy: Most energy that the hand had got by any time [J]; a passive patient
            gives none.
        step: Largest change of the felt force in a frame [N].
        stopped: Cause of a STOP; empty without one.
        packets: Datagrams a second, the busier direction [1/s].
        bits: Bits a second with headers, the busier direction [bit/s].
        folded: Measurements learned from [–].
        friction: μ that was learned [–].
    """

    trial: Trial
    time: Array = field(repr=False)
    felt: Array = field(repr=False)
    true: Array = field(repr=False)
    error: float
    drag_error: float
    largest: float
    energy: float
    step: float
    stopped: str
    packets: float
    bits: float
    folded: int
    friction: float

    def as_dict(self) -> dict[str, Any]:
        """All figures, without the curves."""
        kept = ("error", "drag_error", "largest", "energy", "step", "packets", "bits")
        units = ("N", "N", "N", "J", "N", "per_s", "per_s")
        figures = {
            f"{name}_{unit}": getattr(self, name)
            for name, unit in zip(kept, units, strict=True)
        }
        told = {"stopped": self.stopped, "folded": self.folded, "mu": self.friction}
        return {**asdict(self.trial), **figures, **told}


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
    seen, _ = decoded_surface(sent, None)
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


def simulation(trial: Trial, subject: Subject | None = None) -> Simulation:
    """A session that has not begun.

    Args:
        trial: What is simulated.
        subject: Who is examined; by default the example's torso.
    """
    who, patient = subject or example_subject(), simulated_patient(trial, subject)
    content = prepared(trial.prior, surface=who.surface, shell=who.shell)
    session = Simulation(
        made_operator(trial.comparator, who.shell),
        Follower(3, who.surface, content),
        Hand(who.examination(), again=MEETING),
        patient,
        trial.impairment(),
    )
    if trial.camera and trial.breathing:
        session.skin = partial(_seen_skin, SkinMotion(), patient.breathing)
    return session


def simulated_patient(trial: Trial, subject: Subject | None = None) -> SimulatedPatient:
    """The patient of a trial, see `simulation`."""
    tissue: Tissue = ElasticTorso(trial.friction)
    if subject is not None:
        own = subject.surface, subject.shell
        tissue = FieldTissue.below(*own, friction=trial.friction)
    breathing = Breathing(trial.breathing)
    return SimulatedPatient(tissue, breathing=breathing, seed=trial.seed)


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
    figures = _Figures(ElasticTorso(trial.friction), trial.settled)
    for moment in session.run(trial.seconds):
        figures.add(moment)
        if watch is not None:
            watch(moment)
    sides = session.operator.peer, session.follower.peer
    model = session.operator.model
    time, felt, true = (np.array(curve) for curve in figures.curves)
    return TrialResult(
        trial,
        time,
        felt,
        true,
        *figures.errors,
        figures.largest,
        figures.energy,
        figures.step,
        next((s.safety.cause for s in sides if s.safety.state == 2), ""),
        max(s.rate.sent_packets for s in sides) / trial.seconds,
        8.0 * max(s.rate.sent_bytes for s in sides) / trial.seconds,
        session.operator.folded,
        0.0 if model is None else model.learner.friction,
    )


class _Figures:
    """Figures of frames as they come, in memory that stays as small."""

    def __init__(self, truth: Tissue, settled: float) -> None:
        self._truth, self._settled = truth, settled
        self.curves = tuple(array("d") for _ in range(3))  # time, felt, true
        self.largest = self.energy = self.step = 0.0
        self._work, self._missed = 0.0, np.zeros(2)
        self._frames = self._counted = 0
        self._every = COMPARED
        self._felt = self._place = np.zeros(3)

    def add(self, moment: Moment) -> None:
        """Take a frame."""
        felt, place = moment.felt[:3], moment.position
        size = math.sqrt(felt @ felt)
        self.largest = max(self.largest, size)
        if self._frames:
            change = felt - self._felt
            self._work += 0.5 * float((felt + self._felt) @ (place - self._place))
            self.energy = max(self.energy, self._work)
            self.step = max(self.step, math.sqrt(change @ change))
        if self._frames % COMPARED == 0:
            self._compare(moment, size)
        self._felt, self._place = felt, place
        self._frames += 1

    def _compare(self, moment: Moment, size: float) -> None:
        """With what the patient at rest would answer at the hand's pose."""
        pose, moved = (moment.rotation, moment.position), self._place
        speed = (pose[1] - moved) / HAPTIC if self._frames else np.zeros(3)
        still, dragged = (
            float(np.linalg.norm(self._truth.wrench(*pose, v)[:3]))
            for v in (np.zeros(3), speed)
        )
        if self._frames % self._every == 0:
            self._keep(moment.time, size, still)
        if moment.time > self._settled and max(still, size) > 0.5:
            self._missed += abs(size - still), abs(size - dragged)
            self._counted += 1

    def _keep(self, *values: float) -> None:
        """Add to the curves: time [s], felt and true force [N]."""
        for curve, value in zip(self.curves, values, strict=True):
            curve.append(value)
        if len(self.curves[0]) >= MOST_KEPT:
            self.curves = tuple(curve[::2] for curve in self.curves)
            self._every *= 2

    @property
    def errors(self) -> tuple[float, float]:
        """Mean difference of felt and true force in contact, at rest and moved [N]."""
        n = self._counted or math.nan
        return float(self._missed[0] / n), float(self._missed[1] / n)

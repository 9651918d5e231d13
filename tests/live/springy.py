"""A small session: a springy cylinder, a probe, a hand that presses into it."""

from functools import cache

import numpy as np

import ttus_opt as tt
from ttus_opt.live.follower import Follower
from ttus_opt.live.impairment import Impairment
from ttus_opt.live.messages import Sample
from ttus_opt.live.model import LiveModel, ModelPlan, encode_model
from ttus_opt.live.operator import Operator
from ttus_opt.live.simulation import Simulation
from ttus_opt.live.subject import Hand
from ttus_opt.message import decode, encode

RADIUS, BALL = 0.10, 0.02
PLAN = ModelPlan((12, 24, 12), 0.04, tt.terms.DepthProfile((1.3,), (5.0,)))


class Spring:
    """A cylinder of 500 N/m below a ball; its force can be replaced."""

    stiffness = 500.0
    wrench = None

    def sense(self, time, rotation, position):
        r = float(np.hypot(position[0], position[1]))
        depth = max(RADIUS + BALL - r, 0.0)
        out = np.array([position[0] / r, position[1] / r, 0.0])
        wrench = np.concatenate([self.stiffness * depth * out, np.zeros(3)])
        given = wrench if self.wrench is None else np.asarray(self.wrench, float)
        return Sample(time, rotation.copy(), position.copy(), given)


@cache
def parts():
    z = np.linspace(0.0, 0.3, 31)
    surface = tt.Surface.from_radius(np.full((60, 31), RADIUS), z)
    shell = tt.PointShell.from_spec(f"sphere:{BALL}", n_points=200)
    sent = encode(surface)
    model = LiveModel(decode(sent), shell, PLAN)
    return surface, shell, (sent, encode_model(model))


def path(seconds=20.0, depth=0.02, period=4.0, lifted=1.0):
    """Presses of some depth, after the probe was held above the skin for a while."""
    t = np.arange(0.0, seconds, 0.05)
    wave = np.sin(np.pi * np.maximum(t - lifted, 0.0) / period) ** 2
    r = RADIUS + BALL + 0.005 - (depth + 0.005) * wave
    position = np.stack([r, np.zeros_like(r), np.full_like(r, 0.15)], axis=1)
    return tt.Trajectory(t, position, np.tile(np.eye(3), (len(t), 1, 1)))


def session(impairment=None, *, moved=None, patient=None, **options):
    surface, shell, content = parts()
    return Simulation(
        Operator(2, shell, **options),
        Follower(3, surface, content),
        Hand(moved or path()),
        patient or Spring(),
        impairment or Impairment(),
    )


def passes(simulation, seconds):
    """The session goes on, and nobody looks."""
    for _ in simulation.run(seconds):
        pass

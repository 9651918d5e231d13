"""`RecursiveFit` whose measurements come, fade and go, against dense algebra."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import (
    RuleBasedStateMachine,
    initialize,
    invariant,
    precondition,
    rule,
)

import ttus_opt as tt
from tests.kit import ellipsoid, presses, torso
from ttus_opt.fitting.recursion.dual_recursion import DualRecursion

#: What the issue asks for: the field is the batch fit's up to this part
EXACT = 1e-8

#: Weight λ, with 1e-4 to 10 for the range that is asked for
WEIGHTS = [1e-4, 1e-2, 1.0, 10.0]

#: A pose without contact
SILENT = -1


@functools.cache
def scene():
    """A handful of voxels, and a probe that lingers, wanders and jumps."""
    surface, rng = torso(), np.random.default_rng(3)
    at, poses = np.repeat([0, 1, 2], [7, 7, 6]), presses(surface, 3, rng)
    # three spots, the probe a millimetre aside each time, and single presses all over
    near = tt.Trajectory(
        0.05 * np.arange(20),
        poses.position[at] + rng.normal(0.0, 1e-3, (20, 3)),
        poses.rotation[at],
        poses.force[at] + rng.normal(0.0, 0.2, (20, 3)),
        poses.torque[at],
    )
    return tt.Scene.assemble(
        tt.Voxmap.from_surface(surface, shape=(7, 12, 7), r_inner=0.03),
        ellipsoid(),
        tt.Trajectory.concatenate([near, presses(surface, 20, rng)]),
        inner=2.0,
        outer=1.5,
        sampling="trilinear",
    )


class DenseSolves:
    """Solves with a dense L, and as wrong as their relative residual may be."""

    def __init__(self, told):
        self.grid = told.laplace.grid
        self._inverse = np.linalg.inv(told.L.toarray())
        self._error = np.random.default_rng(1).normal(size=told.n_voxels)
        self._error /= np.linalg.norm(self._error)

    def solve(self, right_side, *, rtol=1e-12):
        error = rtol * np.linalg.norm(right_side) * self._error
        return self._inverse @ (right_side + error)

    def solve_adjoint(self, right_side, *, rtol=1e-12):
        error = rtol * np.linalg.norm(right_side) * self._error
        return (right_side + error) @ self._inverse


@functools.cache
def quick():
    """The scene with solves that take no time."""
    return replace(scene(), laplace=DenseSolves(scene()))


@functools.cache
def dense():
    """p₀, unweighted rows H of all poses, L⁻¹L⁻ᵀHᵀ, and targets."""
    told = scene()
    L, n = told.L.toarray(), len(told.trajectory)
    forces, torques = told.N.toarray(), told.W.toarray() / told.torque_length
    H = np.concatenate(
        [forces.reshape(n, 3, -1), torques.reshape(n, 3, -1)], axis=1
    ).reshape(6 * n, -1)
    t = np.concatenate(
        [told.trajectory.force, told.trajectory.torque / told.torque_length], axis=1
    )
    X = np.linalg.solve(L, np.linalg.solve(L.T, H.T))
    return np.linalg.solve(L, told.b), H, X, t.reshape(-1)


def batch(poses, weights):
    """Eq. 10's field of poses with weights of their own, without any recursion."""
    p0, H, X, t = dense()
    # what was measured twice has twice the weight
    sums = np.bincount(np.array(poses, dtype=np.int64), weights, len(t) // 6)
    roots = np.repeat(np.sqrt(sums), 6)
    K = roots[:, None] * (H @ X) * roots
    y = np.linalg.solve(np.eye(len(t)) + K, roots * (t - H @ p0))
    return p0 + X @ (roots * y)


def start(weight, told):
    return tt.RecursiveFit(
        told,
        force_weight=weight,
        torque_weight=weight,
        outlier_level=None,
        fold_scene=False,
    )


def add(fit, pose):
    if pose == SILENT:
        far = np.array([9.0, 0.0, 0.1])
        fit.update(np.eye(3), far, np.ones(3), np.zeros(3))
        return
    told = scene().trajectory
    fit.update(
        told.rotation[pose], told.position[pose], told.force[pose], told.torque[pose]
    )


class Held:
    """A fit, and what it shall hold: number, pose and weight, in the order of time."""

    def __init__(self, weight, told):
        self.fit = start(weight, told)
        self.weight = weight
        self.count = 0
        self.entries: list[tuple[int, int, float]] = []

    def add(self, pose):
        add(self.fit, pose)
        self.entries.append((self.count, pose, self.weight))
        self.count += 1

    def keep(self, window):
        self.fit.forget(window=window)
        self.entries = self.entries[max(0, len(self.entries) - window) :]
        # one too many that goes now would have gone next: look at once
        self.compare_numbers()

    def fade(self, factor):
        self.fit.forget(factor)
        self.entries = [(i, pose, factor * w) for i, pose, w in self.entries]

    def remove(self, place):
        number, _, _ = self.entries.pop(place % len(self.entries))
        self.fit.downdate(number)

    def compare_numbers(self):
        """What shall be held is held, and nothing else."""
        touching = tuple(i for i, pose, _ in self.entries if pose != SILENT)
        assert self.fit.measurements == len(self.entries)
        assert self.fit.in_contact == touching

    def check(self):
        """The distance from the batch fit of what shall be held."""
        self.compare_numbers()
        touching = [entry for entry in self.entries if entry[1] != SILENT]
        expected = batch([pose for _, pose, _ in touching], [w for *_, w in touching])
        values = self.fit.field.values.reshape(-1)
        return float(np.linalg.norm(values - expected) / np.linalg.norm(expected))


def test_the_dense_reference_is_the_closed_form():
    told = scene()
    expected = tt.fit(
        told, "eq10", solver="closed_form", force_weight=1e-2, torque_weight=1e-2
    ).field.values.reshape(-1)
    n = len(told.trajectory)
    assert np.allclose(batch(list(range(n)), [1e-2] * n), expected, rtol=1e-8)


class Measurements(RuleBasedStateMachine):
    """Anything a caller may do, in any order."""

    @initialize(weight=st.sampled_from(WEIGHTS))
    def begin(self, weight):
        self.held = Held(weight, quick())

    @rule(poses=st.lists(st.integers(-1, 39), min_size=1, max_size=6))
    def add(self, poses):
        for pose in poses:
            self.held.add(pose)

    @rule(pose=st.integers(0, 39), times=st.integers(1, 5))
    def linger(self, pose, times):
        for _ in range(times):
            self.held.add(pose)

    @rule(window=st.integers(0, 12))
    def keep(self, window):
        self.held.keep(window)

    @rule(factor=st.floats(0.05, 1.0))
    def fade(self, factor):
        self.held.fade(factor)

    @precondition(lambda self: self.held.entries)
    @rule()
    def remove_the_oldest(self):
        self.held.remove(0)

    @precondition(lambda self: self.held.entries)
    @rule(place=st.integers(0, 100))
    def remove_any(self, place):
        self.held.remove(place)

    @rule(weight=st.sampled_from(WEIGHTS))
    def fold_what_is_held_with_another_weight(self, weight):
        entries, self.held = self.held.entries, Held(weight, quick())
        for _, pose, _ in entries:
            self.held.add(pose)

    @invariant()
    def is_the_batch_fit(self):
        assert self.held.check() < EXACT


Measurements.TestCase.settings = settings(max_examples=4, stateful_step_count=12)
TestMeasurements = Measurements.TestCase


def slide(held, updates, window, every, fading):
    """Measure for ever, and compare with the batch fit every so often."""
    rng = np.random.default_rng(window)
    pose = 0
    for update in range(1, updates + 1):
        # it lingers on the first 20, and goes elsewhere at times
        pose = (pose + 1) % 20 if rng.uniform() < 0.8 else int(rng.integers(40))
        held.add(SILENT if rng.uniform() < 0.1 else pose)
        if fading and update % 7 == 0:
            held.fade(0.9)
        if update % 11 == 0:
            held.remove(int(rng.integers(len(held.entries))))
        held.keep(window)
        if update % every == 0:
            assert held.check() < EXACT


@pytest.mark.slow
@pytest.mark.parametrize(
    ("weight", "fading"),
    [
        (1e-4, False),
        (10.0, True),
        pytest.param(1e-2, True, marks=pytest.mark.slow),
        pytest.param(1.0, False, marks=pytest.mark.slow),
    ],
)
def test_a_window_slides_on_and_on(weight, fading):
    held = Held(weight, quick())
    slide(held, 100, 20, 20, fading)
    # what a window holds does not grow with what went
    before = held.fit.memory_bytes
    slide(held, 100, 20, 20, fading)
    assert held.fit.memory_bytes <= 2 * before


@pytest.mark.slow
def test_a_window_slides_with_the_solves_of_the_multigrid(monkeypatch):
    # R is sound by itself: making it anew is for what cannot be foreseen
    monkeypatch.setattr(DualRecursion, "_rebuild", None)
    held = Held(1e-2, scene())
    slide(held, 80, 20, 20, fading=False)
    assert held.fit._system._kernel._residual.max() < 1e-4


#: All windows with all weights when long; when slow, each of them at least once
WINDOWS = [
    pytest.param(weight, window, marks=[] if i % 3 == j else pytest.mark.long)
    for i, weight in enumerate(WEIGHTS)
    for j, window in enumerate((20, 200, 400))
]


@pytest.mark.slow
@pytest.mark.parametrize(("weight", "window"), WINDOWS)
def test_thousands_of_updates(weight, window):
    """20,000 in all; each fit forgets what it held several times over."""
    slide(Held(weight, quick()), 1700, window, 100, fading=True)

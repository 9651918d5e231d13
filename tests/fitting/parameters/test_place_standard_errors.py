"""Standard errors of real fits against dense fits with one place left out."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.dragging import dragged_scene
from ttus_opt.contact.scene import Scene
from ttus_opt.fitting.parameters.identification import PlaceRows
from ttus_opt.problem.formulation import load

WEIGHTS = {"force_weight": 1e-2, "torque_weight": 1e-2}
NOISE = 0.02


def recorded(viscous, shared):
    """Drag that is a part stronger or weaker at every place, and sensor noise."""
    own = {"mu": 0.0, "viscous": 20.0} if viscous else {"mu": 0.3}
    whole = dragged_scene("contact", shape=(8, 18, 9), n=90, **own)
    bare = dragged_scene("contact", shape=(8, 18, 9), n=90, mu=0.0)
    place, rng = whole.places, np.random.default_rng(11)
    part = 1.0 + shared * rng.standard_normal(int(place.max()) + 1)[place, None]
    given, still = whole.trajectory, bare.trajectory
    force = still.force + part * (given.force - still.force)
    torque = still.torque + part * (given.torque - still.torque)
    force += NOISE * rng.normal(size=force.shape)
    torque += NOISE * whole.torque_length * rng.normal(size=torque.shape)
    return replace(whole, trajectory=replace(given, force=force, torque=torque))


def left_out(terms, kept, n):
    """The least-squares solution, and the objective, without some frames' rows."""
    rows, targets = [], []
    for term in terms:
        own = np.repeat(kept, 3) if term.is_measured else slice(None)
        rows.append(np.sqrt(term.weight) * term.matrix.toarray()[own])
        targets.append(np.sqrt(term.weight) * term.target[own])
    A, t = np.vstack(rows)[:, :n], np.concatenate(targets)
    x = np.linalg.solve(A.T @ A, A.T @ t)
    return np.append(x, (A @ x - t) @ (A @ x - t))


def jackknifed(found):
    return float(np.sqrt(len(found) - 1) * np.std(found))


@pytest.mark.slow
def test_viscous_drag_varies_as_without_a_place():
    scene = recorded(viscous=True, shared=0.1)
    solution = tt.fit(scene, "viscous_drag", acts_at="contact", **WEIGHTS)
    terms, V = list(solution.program.terms), scene.n_voxels
    place = scene.places
    assert place.max() > 8
    found = [left_out(terms, place != k, V + 1)[V] for k in np.unique(place)]
    told = solution.standard_errors["viscous_coefficient"]
    assert told == pytest.approx(jackknifed(found), rel=0.25)
    alone = recorded(viscous=True, shared=0.0)
    plain = tt.fit(alone, "viscous_drag", acts_at="contact", **WEIGHTS)
    assert told > 2.0 * plain.standard_errors["viscous_coefficient"]


@pytest.mark.slow
def test_friction_varies_as_without_a_place():
    scene = recorded(viscous=False, shared=0.3)
    solution = tt.fit(scene, "coulomb_global", acts_at="contact", **WEIGHTS)
    declared = load("coulomb_global", scene, acts_at="contact", **WEIGHTS)
    at, h = solution.parameters["friction_coefficient"], 0.02
    place, V, found = scene.places, scene.n_voxels, []
    terms = [list(declared.search.build(at + d).compile().terms) for d in (-h, 0.0, h)]
    for k in np.unique(place):
        low, J, high = (left_out(each, place != k, V)[-1] for each in terms)
        found.append(at - 0.5 * h * (high - low) / (high - 2.0 * J + low))
    told = solution.standard_errors["friction_coefficient"]
    assert told == pytest.approx(jackknifed(found), rel=0.25)


def test_rows_are_those_in_contact_by_place():
    scene = recorded(viscous=False, shared=0.0)
    far = scene.trajectory.position.copy()
    far[10:14] *= [1.3, 1.3, 1.0]
    away = replace(scene.trajectory, position=far)
    scene = Scene.assemble(scene.voxmap, scene.shell, away, inner=3.0, outer=3.0)
    program = load("eq10", scene, **WEIGHTS).compile()
    rows = PlaceRows.of(scene, program)
    assert rows.names == ("force", "torque")
    touching = scene.rows.contact_points > 0
    assert 0 < touching.sum() < len(touching)
    np.testing.assert_array_equal(rows.rows, np.flatnonzero(np.repeat(touching, 3)))
    x = np.random.default_rng(0).normal(size=program.n_variables)
    force, torque = np.split(rows.residuals(program, x), 2)
    own = np.repeat(touching, 3)
    expected = 0.1 * (scene.N @ x - scene.f)[own]
    np.testing.assert_allclose(force, expected)
    expected = 0.1 * ((scene.W @ x - scene.tau) / scene.torque_length)[own]
    np.testing.assert_allclose(torque, expected)
    assert PlaceRows.of(scene, load("robust", scene).compile()) is None

"""The presliding length of recordings, made by an ODE of the bristle."""

import pickle
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

import ttus_opt as tt
from tests.drags import SHELL, SURFACE, VOXMAP, pushing
from tests.kit import dragged_scene
from ttus_opt.contact.friction import FRICTION, PRESLIDING, Sliding
from ttus_opt.contact.rows import contact_rows
from ttus_opt.contact.scene import Scene
from ttus_opt.haptic.field_wrench import wrenches_along
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.problem.formulation import Formulation
from ttus_opt.problem.friction_search import with_drag, with_friction_search
from ttus_opt.problem.terms.drag_estimate import estimate_drag
from ttus_opt.problem.terms.laplace import LaplaceTerm
from ttus_opt.problem.terms.wrench import ForceTerm

MU, LENGTH, NOISE = 0.3, 1e-3, 0.05

#: Share of a contact and displacement there [mm]: strokes with holds, or one slide
HOLDS = ([0, 0.15, 0.3, 0.45, 0.6, 0.75, 0.9, 1], [0, 0, 6, 6, -6, -6, 2, 2])
SLIDE = ([0, 1], [0, 24])


def deflection(times, way, normal, strength, length):
    """b of db/dt = v/l - b max(b v, 0)/l |b|^60, less where the normal force rises."""
    path, across = CubicSpline(times, way), CubicSpline(times, normal)
    rise = CubicSpline(times, np.log(strength)).derivative()

    def rate(t, b):
        n = across(t) / np.linalg.norm(across(t))
        v = path(t, 1)
        v = (v - n * (n @ v)) / length
        stopped = max(b @ v, 0.0) * min(np.linalg.norm(b), 1.2) ** 60
        return v - b * (stopped + max(float(rise(t)), 0.0))

    span = times[0], times[-1]
    return solve_ivp(rate, span, np.zeros(3), t_eval=times, max_step=0.005).y.T


def recorded(stroke, length):
    """Six contacts of 5 s at 20 Hz, dragged by a bristle."""
    rng, parts = np.random.default_rng(0), []
    potential = pushing("trilinear", {})
    times = np.arange(0.0, 5.0, 0.05)
    share = times / times[-1]
    for _ in range(6):
        along = gaussian_filter1d(1e-3 * np.interp(share, *stroke), 2, mode="nearest")
        pressed = 0.006 * np.clip(8.0 * np.minimum(share, 1.0 - share), 0.0, 1.0)
        depth = gaussian_filter1d(pressed, 2, mode="nearest") - 0.002
        where, way = rng.uniform([0.8, 0.07], [2.2, 0.13]), rng.uniform(0.0, 6.28)
        angle, z = where[0] + along * np.cos(way) / 0.12, where[1] + along * np.sin(way)
        r = SURFACE.radius_at(angle, z) + 0.012 - depth
        at = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
        at -= SHELL.reference
        R = np.tile(np.eye(3), (len(times), 1, 1))
        rows = contact_rows(VOXMAP, SHELL, R, at, sampling="trilinear")
        p = 2.0 * potential.values.ravel()
        force, torque = ((m @ p).reshape(-1, 3) for m in (rows.N, rows.W))
        sliding = Sliding.of(VOXMAP, SHELL, Trajectory.from_arrays(at, R, times=times))
        i = np.flatnonzero((sliding.normal != 0.0).any(axis=1))
        M = MU * np.einsum("ti,ti->t", sliding.normal, force)[i]
        drag = np.zeros_like(force)
        b = deflection(times[i], at[i], sliding.normal[i], M, length)
        drag[i] = -M[:, None] * b
        torque += np.cross(sliding.arm, drag) + 3e-3 * rng.normal(size=force.shape)
        force += drag + NOISE * rng.normal(size=force.shape)
        parts.append(Trajectory.from_arrays(at, R, force, torque, times=times))
    return Scene.assemble(VOXMAP, SHELL, Trajectory.concatenate(parts))


def fitted(stroke, length=LENGTH):
    scene = recorded(stroke, length)
    weights = {"force_weight": 10.0, "torque_weight": 10.0}
    return scene, tt.fit(scene, "coulomb_global", acts_at="contact", **weights)


def misfits(scene, solution):
    """Errors of the rendered forces, with the bristle and with drag that fades [N]."""
    held, known = solution.field, solution.parameters
    fading = {name: v for name, v in known.items() if name != PRESLIDING}
    fields, poses = (held, replace(held, parameters=fading)), scene.trajectory
    felt = (wrenches_along(each, SHELL, poses).force for each in fields)
    return [np.sqrt(np.mean((force - scene.f.reshape(-1, 3)) ** 2)) for force in felt]


def test_it_goes_to_another_process_with_its_length():
    scene = dragged_scene("contact")
    found = estimate_drag(scene, "contact")
    guess = replace(
        found, drag=replace(found.drag, presliding=LENGTH, no_presliding="")
    )
    bare = Formulation([LaplaceTerm(scene), ForceTerm(scene, 0.1)])
    declared = with_friction_search(guess, partial(with_drag, bare), 1.0)
    copied = pickle.loads(pickle.dumps(declared)).search.build(0.2)
    assert copied.search.likely == LENGTH
    drag = copied.search.build(2e-3).terms[1].drag
    assert (drag.coefficient, drag.presliding) == (0.2, 2e-3)


@pytest.mark.slow
def test_strokes_and_holds_determine_the_length():
    scene, solution = fitted(HOLDS)
    found, errors = solution.parameters, solution.standard_errors
    assert errors[PRESLIDING] < 0.1 * LENGTH
    assert abs(found[PRESLIDING] - LENGTH) < 3.0 * errors[PRESLIDING]
    assert found[FRICTION] == pytest.approx(MU, abs=0.01)
    assert any(line.startswith(PRESLIDING) for line in solution.identified)
    left, more = misfits(scene, solution)
    assert left < 0.2 * more  # held drag is rendered, with no option


@pytest.mark.slow
def test_of_lengths_that_are_alike_the_longest_is_taken():
    """Below those of 20 Hz; nothing is searched, and the remark says why."""
    scene, solution = fitted(HOLDS, 2e-4)
    assert solution.field.parameters[PRESLIDING] == pytest.approx(4e-4)
    told = "any length below 0.4 mm is as likely"
    assert solution.not_identified[PRESLIDING] == told
    assert f"{PRESLIDING}: not identified ({told}): 0.0004 is used" in (
        solution.identified
    )
    assert solution.parameters[FRICTION] == pytest.approx(MU, abs=0.01)
    left, more = misfits(scene, solution)
    assert left < 0.5 * more  # though it is twice as long


@pytest.mark.slow
def test_a_slide_determines_none_and_says_so():
    _, solution = fitted(SLIDE)
    assert solution.field.parameters[PRESLIDING] == 0.0
    assert "fades at rest explains" in solution.not_identified[PRESLIDING]
    told = f"{PRESLIDING}: not identified (drag"
    assert any(line.startswith(told) for line in solution.identified)

"""Measured forces and torques, by squares and by Huber's penalty."""

from dataclasses import replace

import numpy as np
import pytest

from tests.kit import InputError, refuses, small_scene, with_wrenches
from ttus_opt.fitting.batch import fit
from ttus_opt.problem.terms.structure import Whitened, declared
from ttus_opt.problem.terms.wrench import LENGTHS, RobustForceTerm, TorqueTerm

SCENE = small_scene("trilinear", shape=(5, 8, 6), n_poses=5)


def test_rows_are_over_the_probe_s_root_mean_square_radius():
    shell = SCENE.shell
    square = ((shell.points - shell.reference) ** 2).sum(axis=1)
    radius = np.sqrt(np.average(square, weights=shell.areas))
    rows = TorqueTerm(SCENE).assembled
    p = np.random.default_rng(0).normal(size=SCENE.n_voxels)
    found = rows.blocks["p"] @ p - rows.target
    expected = (SCENE.W @ p - SCENE.tau) / radius
    np.testing.assert_allclose(found, expected, rtol=1e-9)
    literal = TorqueTerm(SCENE, length=1.0).assembled
    np.testing.assert_allclose(
        literal.blocks["p"] @ p - literal.target, SCENE.W @ p - SCENE.tau
    )


def test_without_torques_there_are_no_rows():
    bare = replace(SCENE, trajectory=replace(SCENE.trajectory, torque=None))
    rows = TorqueTerm(bare).assembled
    assert rows.blocks["p"].shape == (0, SCENE.n_voxels) and len(rows.target) == 0


@pytest.mark.parametrize("length", [0.0, -1.0, float("nan"), 2.0 * LENGTHS[1]])
def test_a_length_that_is_none_is_refused(length):
    with pytest.raises(InputError, match="torque_length must lie between"):
        TorqueTerm(SCENE, length=length)


def test_the_tag_says_what_the_rows_were_divided_by():
    by = declared(TorqueTerm(SCENE, length=0.02).assembled.tags, Whitened).by
    np.testing.assert_array_equal(by.toarray(), 50.0 * np.eye(15))


LONG = small_scene("trilinear", n_poses=20)


def test_huber_bends_less_than_squares_to_an_outlier():
    """One frame with a slip of 50 N: the others keep their fit."""
    truth = LONG.N @ LONG.laplace.solve(LONG.b)
    force = truth.reshape(-1, 3).copy()
    touched = int(np.argmax(np.linalg.norm(force, axis=1)))
    bad = force.copy()
    bad[touched] += 50.0
    scene = with_wrenches(LONG, bad, np.zeros_like(LONG.tau))
    others = np.delete(np.arange(len(force)), touched)

    def missed(name, **options):
        solution = fit(scene, name, force_weight=1.0, torque_weight=0.0, **options)
        rendered = (scene.N @ solution.field.values.reshape(-1)).reshape(-1, 3)
        return float(np.abs(rendered - force)[others].max())

    assert missed("robust", limit=0.1) < 0.2 * missed("eq10")


@pytest.mark.parametrize("limit", [0.0, -1.0, float("nan"), float("inf")])
def test_a_limit_that_is_none_is_refused(limit):
    refuses(InputError, "limit must be positive", RobustForceTerm, LONG, 1.0, limit)

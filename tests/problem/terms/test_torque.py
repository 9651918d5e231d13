"""The torque's rows are over a length, by default the probe's."""

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.core.errors import InputError
from ttus_opt.problem.terms.structure import whitening
from ttus_opt.problem.terms.torque import LENGTHS, TorqueTerm

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


def test_the_length_is_a_weight():
    """Half the length is four times the weight."""
    p = np.random.default_rng(1).normal(size=SCENE.n_voxels)
    costs = []
    for length in (0.01, 0.02):
        rows = TorqueTerm(SCENE, length=length).assembled
        costs.append(float(np.sum((rows.blocks["p"] @ p - rows.target) ** 2)))
    assert costs[0] == pytest.approx(4.0 * costs[1])


def test_without_torques_there_are_no_rows():
    bare = replace(SCENE, trajectory=replace(SCENE.trajectory, torque=None))
    rows = TorqueTerm(bare).assembled
    assert rows.blocks["p"].shape == (0, SCENE.n_voxels) and len(rows.target) == 0


@pytest.mark.parametrize("length", [0.0, -1.0, float("nan"), 2.0 * LENGTHS[1]])
def test_a_length_that_is_none_is_refused(length):
    with pytest.raises(InputError, match="torque_length must lie between"):
        TorqueTerm(SCENE, length=length)


def test_the_tag_says_what_the_rows_were_divided_by():
    by = whitening(TorqueTerm(SCENE, length=0.02).assembled.tags)
    np.testing.assert_array_equal(by.toarray(), 50.0 * np.eye(15))

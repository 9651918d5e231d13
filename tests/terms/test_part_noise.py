"""Errors by parts, against components taken by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import small_scene
from ttus_opt.terms.force import ForceTerm
from ttus_opt.terms.part_noise import PartNoise, contact_directions
from ttus_opt.terms.structure import whitening
from ttus_opt.terms.torque import TorqueTerm

SCENE = small_scene("contact-size")
SIZE = np.random.default_rng(0).uniform(0.1, 0.5, len(SCENE.trajectory))


def test_directions_are_those_of_a_field_that_grows_with_depth() -> None:
    u = contact_directions(SCENE)
    touching = SCENE.rows.contact_points > 0
    assert touching.any()
    np.testing.assert_allclose(np.linalg.norm(u[touching], axis=1), 1.0)
    assert not u[~touching].any()
    # out of the patient, the way the skin pushes
    out = SCENE.trajectory.position[touching] * [1.0, 1.0, 0.0]
    assert (np.einsum("ti,ti->t", u[touching], out) > 0.0).all()


def test_residuals_are_divided_part_by_part() -> None:
    """κ s across the contact and for torque, s along it; s over its mean square."""
    noise = PartNoise.of(SCENE, SIZE)
    touching = SCENE.rows.contact_points > 0
    assert noise.level == pytest.approx(np.sqrt(np.mean(SIZE[touching] ** 2)))
    p = np.random.default_rng(1).normal(size=SCENE.n_voxels)
    e = (SCENE.N @ p - SCENE.f).reshape(-1, 3)
    along = np.einsum("ti,ti->t", e, noise.direction)
    across = np.einsum("ti,ti->t", e, e) - along**2
    s = SIZE / noise.level
    expected = along**2 / s**2 + across / (noise.tangential * s) ** 2
    rows = ForceTerm(SCENE, noise=noise).assembled
    found = (rows.blocks["p"] @ p - rows.target).reshape(-1, 3)
    np.testing.assert_allclose((found**2).sum(axis=1)[touching], expected[touching])
    turned = (SCENE.W @ p - SCENE.tau).reshape(-1, 3) / SCENE.torque_length
    rows = TorqueTerm(SCENE, noise=noise).assembled
    found = (rows.blocks["p"] @ p - rows.target).reshape(-1, 3)
    np.testing.assert_allclose(found, turned / (noise.tangential * s)[:, None])


def test_equal_parts_are_the_plain_term() -> None:
    noise = replace(PartNoise.of(SCENE), tangential=1.0)
    for term in (ForceTerm, TorqueTerm):
        plain, same = term(SCENE).assembled, term(SCENE, noise=noise).assembled
        assert abs(plain.blocks["p"] - same.blocks["p"]).max() < 1e-12
        np.testing.assert_allclose(plain.target, same.target)
        found = whitening(plain.tags), whitening(same.tags)
        assert found[1] is not None and (found[0] is None) == (term is ForceTerm)
        if found[0] is not None:
            np.testing.assert_allclose(found[0], found[1])

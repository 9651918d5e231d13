"""The rows that are tuned on, against dense algebra."""

import functools
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import InputError, refuses, three_presses
from ttus_opt.fitting.uncertainty.contact_spread import pressed_places
from ttus_opt.fitting.weights import tuning_rows
from ttus_opt.fitting.weights.tuning_rows import TuningRows
from ttus_opt.problem.formulation import load

MU = 0.3


def rows_of(name, **options):
    return TuningRows.of(load(name, three_presses(), **options))


def contact():
    """Frames in contact, shape (T,)."""
    return np.asarray(three_presses().rows.contact_points > 0)


@functools.cache
def dense():
    """Rows D of forces and torques, their covariance, and what L p = b gives."""
    scene = three_presses()
    D = np.vstack([scene.N.toarray(), scene.W.toarray() / scene.torque_length])
    G = np.linalg.solve(scene.L.toarray().T, D.T)
    return D, G.T @ G, D @ np.linalg.solve(scene.L.toarray(), scene.b)


def used():
    """Rows of frames in contact, of both terms."""
    return np.flatnonzero(np.tile(np.repeat(contact(), 3), 2))


def test_rows_and_targets_are_those_of_weight_one_in_contact():
    scene, rows = three_presses(), rows_of("eq10", force_weight=7.0)
    assert (rows.terms, rows.coefficient) == (("force", "torque"), "")
    assert 0 < contact().sum() < len(contact())
    np.testing.assert_array_equal(rows.chosen, used())
    np.testing.assert_allclose(rows.matrix.toarray(), dense()[0][used()])
    target = np.concatenate([scene.f, scene.tau / scene.torque_length])
    np.testing.assert_allclose(rows.target, target[used()])
    np.testing.assert_array_equal(rows.term, np.repeat([0, 1], 3 * contact().sum()))
    place = np.tile(np.repeat(pressed_places(scene)[contact()], 3), 2)
    np.testing.assert_array_equal(rows.place, place)
    np.testing.assert_array_equal(rows.every, 1.0)


def test_of_many_frames_each_stands_for_several(monkeypatch):
    monkeypatch.setattr(tuning_rows, "MOST_FRAMES", 5)
    rows = rows_of("eq10")
    step = -(-contact().sum() // 5)
    kept = np.flatnonzero(contact())[::step]
    assert set(rows.chosen // 3) == set(kept) | set(kept + len(contact()))
    np.testing.assert_array_equal(rows.every, float(step))


def test_a_coefficients_rows_are_what_any_two_differ_by():
    """N − μ F is affine in μ."""
    rows = rows_of("coulomb_global")
    assert (rows.coefficient, rows.highest) == ("friction_coefficient", 1.0)
    search = rows_search()
    given = TuningRows.of(search.build(MU)).matrix
    assert abs(rows.matrix + MU * rows.slope - given).max() < 1e-10
    force = next(t for t in search.build(MU).terms if isinstance(t, tt.terms.ForceTerm))
    drag = -force.drag.rows.force[np.flatnonzero(np.repeat(contact(), 3))]
    assert abs(rows.slope[: drag.shape[0]] - drag).max() < 1e-10


def rows_search():  # type: ignore[no-untyped-def]
    search = load("coulomb_global", three_presses()).search
    assert search is not None
    return search


def test_rows_that_bend_in_the_coefficient_are_refused():
    search, rows = rows_search(), rows_of("coulomb_global").measured
    with pytest.raises(InputError, match="affine"):
        tuning_rows._slope(
            lambda mu: search.build(mu**2), 0.0, 1.0, tuning_rows._stack(rows)
        )


def test_the_variance_is_that_of_rows_in_contact(monkeypatch):
    """Hutchinson's estimate, within four of its standard deviations."""
    probes = 400
    monkeypatch.setattr(tuning_rows, "PROBES", probes)
    C = dense()[1]
    at = np.flatnonzero(np.repeat(contact(), 3))
    C = C[np.ix_(at, at)]
    off = C - np.diag(np.diag(C))
    std = np.sqrt(2.0 * np.sum(off**2) / probes) / len(at)
    expected = np.trace(C) / len(at)
    assert 4.0 * std < 0.1 * expected
    assert abs(rows_of("eq10").variance() - expected) < 4.0 * std


def test_the_basis_has_covariance_and_mean_of_the_rows():
    weight, at = 1e3, used()
    found = rows_of("eq10").over_basis(weight)
    _, C, base = dense()
    left = C[np.ix_(at, at)] - found.images.T @ found.images
    # what the basis leaves out is positive, to the solves' accuracy, and as little as
    # is said
    assert np.linalg.eigvalsh(left).min() > -tuning_rows.FIELD_RTOL * C.max()
    assert np.trace(left) * weight <= tuning_rows.MISSING
    atol = 1e-5 * np.abs(base).max()
    np.testing.assert_allclose(found.base, base[at], atol=atol)
    assert found.at(0.5) is found


@pytest.mark.slow
def test_any_squares_are_a_prior():
    """Of a Laplace and a Tikhonov term, whose Hessian is factorised."""
    declared = load("tikhonov", three_presses(), ridge=0.1, reference="zero")
    rows = TuningRows.of(declared)
    found, at = rows.over_basis(10.0), used()
    scene, D = three_presses(), dense()[0][at]
    free = np.diag(scene.laplace.free.astype(float))
    Q = (scene.L.T @ scene.L).toarray() + 0.1 * free
    C = D @ np.linalg.solve(Q, D.T)
    atol = 1e-6 * np.abs(C).max()
    np.testing.assert_allclose(found.images.T @ found.images, C, atol=atol)
    base = D @ np.linalg.solve(Q, scene.L.T @ scene.b)
    np.testing.assert_allclose(found.base, base, atol=1e-6 * np.abs(base).max())
    n = int((rows.term == 0).sum())
    assert rows.variance() == pytest.approx(np.diag(C)[:n].mean(), rel=1e-6)


def test_unknowns_beside_the_field_are_known_by_measurements_alone():
    """Their columns have a variance beyond any measurement's."""
    rows = TuningRows.of(load("viscous_drag", three_presses()))
    found, V = rows.over_basis(10.0), three_presses().n_voxels
    column = rows.matrix[:, V:].toarray()
    plain = rows_of("eq10").over_basis(10.0)
    extra = len(found.images) - column.shape[1]
    covariance = [K.T @ K for K in (found.images[:extra], plain.images)]
    scale = np.abs(covariance[0]).max()
    np.testing.assert_allclose(*covariance, atol=0.01 * scale)
    wide = found.images[extra:]
    size = np.linalg.norm(rows.target)
    assert np.linalg.norm(wide) == pytest.approx(tuning_rows.WIDE * size)
    np.testing.assert_allclose(wide / wide.max(), column.T / column.max(), atol=1e-12)


@dataclass(frozen=True)
class HeightTerm(tt.Term):
    """A user's own measurement: mean potential of seven parts of the patient."""

    scene: tt.Scene = field(repr=False, kw_only=True)
    name: ClassVar[str] = "height"
    measures: ClassVar[bool] = True

    def rows(self):
        V = self.scene.n_voxels
        parts = sp.csr_array(np.arange(7)[:, None] == np.arange(V) * 7 // V)
        return tt.AffineRows({"p": parts.astype(float)}, np.linspace(1.0, 2.0, 7))


def test_rows_of_no_frames_are_left_out_in_parts():
    scene = three_presses()
    rows = TuningRows.of(load("eq10", scene) + HeightTerm(scene=scene))
    assert rows.terms == ("force", "torque", "height")
    own = rows.term == 2
    assert own.sum() == 7 and len(np.unique(rows.place[own])) == 7
    assert rows.place[own].max() < 0 <= rows.place[~own].min()


@pytest.mark.parametrize(
    "name", ["depth_map", "coulomb_drag", "robust", "laplace_only"]
)
def test_another_kind_is_refused(name):
    refused = refuses(InputError, f"{name} cannot be tuned", rows_of, name)
    assert ("no weights" in refused) == (name == "laplace_only")

"""Compression of measured rows against dense algebra; what is left alone."""

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp

import ttus_opt as tt
from tests.kit import small_scene
from tests.solvers.problems import bounds, program, rows, term
from ttus_opt.problem import compression
from ttus_opt.problem.compression import Compression, compressed_rows
from ttus_opt.problem.formulation import load

RNG = np.random.default_rng(3)


def windows(m, n, width):
    """Rows that touch a window of columns which moves along, as a recording does."""
    start = (np.arange(m) * (n - width)) // m
    columns = start[:, None] + np.arange(width)
    starts = np.arange(0, m * width + 1, width)
    values = RNG.standard_normal(m * width)
    return sp.csr_array((values, columns.ravel(), starts), shape=(m, n))


@pytest.mark.parametrize("block", [16, 50, 10_000], ids=["many", "some", "one"])
def test_the_least_squares_stay_the_same(block, monkeypatch):
    """Normal equations M'M, M't, and a constant difference of the costs."""
    monkeypatch.setattr(compression, "BLOCK", block)
    M, t = windows(400, 30, 5), RNG.standard_normal(400)
    M = sp.csr_array(sp.hstack([M, sp.csr_array((400, 7))]))
    R, c = compressed_rows(M, t)
    assert R.shape[0] < 200 if block < 50 else R.shape[0] <= 30
    np.testing.assert_allclose((R.T @ R).toarray(), (M.T @ M).toarray(), atol=1e-11)
    np.testing.assert_allclose(R.T @ c, M.T @ t, atol=1e-11)
    x, y = RNG.standard_normal((2, 37))
    lost = [np.sum((M @ z - t) ** 2) - np.sum((R @ z - c) ** 2) for z in (x, y)]
    best = np.linalg.lstsq(M.toarray(), t, rcond=None)[0]
    least = np.sum((M @ best - t) ** 2)
    if block == 10_000:  # nothing is left over but what cannot be fitted
        np.testing.assert_allclose(lost, least, rtol=1e-9)
    np.testing.assert_allclose(lost[0], lost[1], rtol=1e-9)


def test_rows_that_depend_on_each_other():
    M = sp.csr_array(np.outer(np.arange(1.0, 41.0), [1.0, 2.0, 0.0]))
    R, c = compressed_rows(M, np.ones(40))
    np.testing.assert_allclose((R.T @ R).toarray(), (M.T @ M).toarray(), rtol=1e-12)
    np.testing.assert_allclose(R.T @ c, M.T @ np.ones(40), rtol=1e-12)


def test_only_squares_with_many_rows_are_compressed(monkeypatch):
    monkeypatch.setattr(compression, "LEAST_ROWS", 40)
    many, few = np.ones((60, 2)), np.ones((30, 2))
    wide = np.ones((60, 50))
    M = {"a": many, "b": few, "c": many, "d": wide}
    held = [rows("limit", many[:, :1] @ np.ones((1, 50)), np.zeros(60), np.ones(60))]
    padded = {k: np.pad(v, ((0, 0), (0, 50 - v.shape[1]))) for k, v in M.items()}
    made = program(
        [
            term(padded["a"], np.ones(60), 2.0, name="a"),
            term(padded["b"], np.ones(30), name="b"),
            term(padded["c"], np.ones(60), 1.0, tt.terms.Huber(0.5), name="c"),
            term(padded["d"], np.ones(60), name="d"),
        ],
        held,
        [bounds("box", np.zeros(50), np.ones(50))],
    )
    compress = Compression()
    short = compress(made)
    assert compress.rows == {"a": (60, 2)}
    assert short.constraints == made.constraints and short.bounds == made.bounds
    assert short.terms[1:] == made.terms[1:]
    assert short.terms[0].weight == 2.0
    assert compress(made).terms[0].matrix is short.terms[0].matrix  # kept
    first, *others = made.terms
    thrice = replace(made, terms=(replace(first, matrix=3.0 * first.matrix), *others))
    R, M = (of.terms[0].matrix for of in (compress(thrice), thrice))
    np.testing.assert_allclose((R.T @ R).toarray(), (M.T @ M).toarray(), atol=1e-9)


@pytest.mark.parametrize(
    "name", ["eq10", "eq10_sign", "viscous_drag", "tikhonov", "robust"]
)
def test_a_fit_is_the_same_and_judged_by_all_rows(name, monkeypatch):
    scene = small_scene("trilinear", shape=(9, 12, 8), n_poses=150)
    whole = tt.fit(scene, name)
    monkeypatch.setattr(compression, "LEAST_ROWS", 100)
    monkeypatch.setattr(compression, "OVERDETERMINED", 1.5)
    short = tt.fit(scene, name)
    assert short.compressed and not whole.compressed
    assert short.status is tt.Status.SOLVED
    assert ("robust_force" in short.compressed) is False
    assert short.objective == pytest.approx(whole.objective, rel=1e-6)
    values = [s.field.values for s in (whole, short)]
    assert np.abs(values[0] - values[1]).max() <= 1e-4 * np.abs(values[0]).max()
    assert short.standard_errors == pytest.approx(whole.standard_errors, rel=1e-3)


def test_other_weights_and_values_are_compressed_again(monkeypatch):
    monkeypatch.setattr(compression, "LEAST_ROWS", 100)
    monkeypatch.setattr(compression, "OVERDETERMINED", 1.5)
    scene = small_scene("trilinear", shape=(9, 12, 8), n_poses=150)
    declared = load("eq10", scene)
    fitter = tt.Fitter(declared)
    fitter.solve()
    other = declared.with_weights(force=0.3)
    fitter.update(other)
    again, fresh = fitter.solve(), tt.fit(scene, other)
    assert again.objective == pytest.approx(fresh.objective, rel=1e-9)


def test_a_motion_that_returns_to_its_places_is_compressed_like_one_that_does_not():
    """Blocks of rows in the order of time would touch all columns and stay."""
    rng = np.random.default_rng(5)
    n_places, visits, width = 100, 30, 12
    place = np.tile(rng.permutation(n_places), visits)
    columns = (12 * place[:, None] + np.arange(width)).ravel()
    starts = width * np.arange(len(place) + 1)
    shape = (len(place), 12 * n_places)
    M = sp.csr_array((rng.standard_normal(len(columns)), columns, starts), shape=shape)
    R, c = compressed_rows(M, rng.standard_normal(len(place)))
    assert len(c) <= 1.5 * shape[1]
    assert abs(R.T @ R - M.T @ M).max() <= 1e-10 * abs(M.T @ M).max()

"""The series that is tuned on, against dense algebra."""

from __future__ import annotations

import functools
import itertools
from dataclasses import replace

import numpy as np
import pytest

from tests.conftest import small_scene
from tests.dragging import dragged_scene
from tests.fitting import test_weight_criteria
from ttus_opt.errors import InputError
from ttus_opt.fitting import tuning_series
from ttus_opt.fitting.tuning_series import TuningRows, coarser
from ttus_opt.fitting.weight_criteria import presses
from ttus_opt.problem.formulation import load
from ttus_opt.scene import Scene
from ttus_opt.terms.drag_force import DragForceTerm

MU = 0.3


@functools.cache
def three_presses() -> Scene:
    return test_weight_criteria.three_presses()


def rows_of(name: str, **options: float) -> TuningRows:
    return TuningRows.of(load(name, three_presses(), **options))


def contact() -> np.ndarray:
    """Frames in contact, shape (T,)."""
    return np.asarray(three_presses().rows.contact_points > 0)


@functools.cache
def dense() -> tuple[np.ndarray, ...]:
    """Rows D of forces and torques, their covariance, and what L p = b gives."""
    scene = three_presses()
    D = np.vstack([scene.N.toarray(), scene.W.toarray() / scene.torque_length])
    G = np.linalg.solve(scene.L.toarray().T, D.T)
    return D, G.T @ G, D @ np.linalg.solve(scene.L.toarray(), scene.b)


def test_rows_and_targets_are_those_of_weight_one() -> None:
    scene, rows = three_presses(), rows_of("eq10", force_weight=7.0)
    assert (rows.terms, rows.coefficient) == (("force", "torque"), "")
    assert rows.n_rows == 3 * len(scene.trajectory)
    np.testing.assert_allclose(rows.system.rows.toarray(), dense()[0])
    target = np.concatenate([scene.f, scene.tau / scene.torque_length])
    np.testing.assert_allclose(rows.target, target)
    np.testing.assert_allclose(rows.b, scene.b)
    np.testing.assert_array_equal(rows.system.root_weights, 1.0)


def test_a_coefficients_rows_stand_below() -> None:
    """N − μ F is affine in μ: F is what any two of them differ by."""
    rows, n = rows_of("coulomb_global"), 2 * rows_of("eq10").n_rows
    assert (rows.coefficient, rows.highest) == ("friction_coefficient", 1.0)
    assert rows.system.rows.shape[0] == len(rows.target) == 2 * n
    whole, slope = rows.system.rows[:n], rows.system.rows[n:]
    search = rows_search()
    given = TuningRows.of(search.build(MU)).system.rows
    assert abs(whole + MU * slope - given).max() < 1e-10
    force = next(t for t in search.build(MU).terms if isinstance(t, DragForceTerm))
    drag = -force.drag.rows.force
    assert abs(slope[: drag.shape[0]] - drag).max() < 1e-10
    assert not rows.target[n:].any()


def rows_search():  # type: ignore[no-untyped-def]
    search = load("coulomb_global", three_presses()).search
    assert search is not None
    return search


def test_rows_that_bend_in_the_coefficient_are_refused() -> None:
    search, rows = rows_search(), rows_of("coulomb_global").system.rows
    n = rows.shape[0] // 2
    with pytest.raises(InputError, match="affine"):
        tuning_series._slope(lambda mu: search.build(mu**2), 0.0, 1.0, rows[:n])


def test_the_variance_is_that_of_rows_in_contact(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Hutchinson's estimate, within four of its standard deviations."""
    probes = 400
    monkeypatch.setattr(tuning_series, "PROBES", probes)
    C = dense()[1]
    at = np.flatnonzero(np.repeat(contact(), 3))
    C = C[np.ix_(at, at)]
    off = C - np.diag(np.diag(C))
    std = np.sqrt(2.0 * np.sum(off**2) / probes) / len(at)
    expected = np.trace(C) / len(at)
    assert 4.0 * std < 0.1 * expected
    assert abs(rows_of("eq10").variance() - expected) < 4.0 * std


def test_a_series_has_covariance_and_mean_of_frames_in_contact() -> None:
    scene, weight = three_presses(), 1e3
    series = rows_of("eq10").series(weight)
    _, C, base = dense()
    touching, T = contact(), len(scene.trajectory)
    assert 0 < touching.sum() < T
    at = np.flatnonzero(np.tile(np.repeat(touching, 3), 2))
    K = series.images.reshape(len(series.images), -1)
    left = C[np.ix_(at, at)] - K.T @ K
    # what the basis leaves out is positive, to the solves' accuracy, and as little as
    # is said
    assert np.linalg.eigvalsh(left).min() > -tuning_series.FIELD_RTOL * C.max()
    assert np.trace(left) * weight <= tuning_series.MISSING
    np.testing.assert_allclose(
        series.base.reshape(-1), base[at], atol=1e-5 * np.abs(base).max()
    )
    target = np.concatenate([scene.f, scene.tau / scene.torque_length])
    np.testing.assert_allclose(series.target.reshape(-1), target[at])
    np.testing.assert_array_equal(series.time, scene.trajectory.time[touching])
    np.testing.assert_array_equal(series.press, presses(scene)[touching])


def test_rows_include_those_with_the_coefficient_at_zero() -> None:
    plain, drag = rows_of("eq10"), rows_of("coulomb_global")
    assert drag.include(plain)
    assert drag.include(drag)
    assert not plain.include(drag)
    assert not drag.include(rows_of("coulomb_global"))
    assert drag.include(rows_of("eq10", force_weight=5.0))  # weights are no rows
    assert drag.include(rows_of("eq10_sign"))  # nor are limits
    scene = three_presses()
    louder = replace(scene.trajectory, force=2.0 * scene.trajectory.force)  # type: ignore[operator]
    other = replace(scene, trajectory=louder)
    assert not drag.include(TuningRows.of(load("eq10", other)))
    search = rows_search()
    assert not plain.include(TuningRows.of(search.build(MU)))


def test_a_coarse_scene_keeps_shape_and_boundary(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    scene = small_scene("trilinear", shape=(12, 24, 16), n_poses=4)
    assert coarser(scene) is scene
    most = scene.n_voxels // 4
    monkeypatch.setattr(tuning_series, "MOST_VOXELS", most)
    coarse = coarser(scene)
    assert 0.6 * most < coarse.n_voxels < 1.6 * most
    whole, own = scene.voxmap.grid, coarse.voxmap.grid
    shares = np.divide(own.shape, whole.shape)
    np.testing.assert_allclose(shares, shares.mean(), rtol=0.25)
    assert (own.r_inner, own.r_outer) == (whole.r_inner, whole.r_outer)
    assert (coarse.inner, coarse.outer) == (scene.inner, scene.outer)
    assert coarse.sampling == scene.sampling
    assert coarse.trajectory is scene.trajectory


def test_a_boundary_that_was_fitted_is_fitted_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    given = dragged_scene("contact", mu=0.0)
    scene = Scene.assemble(
        given.voxmap,
        given.shell,
        given.trajectory,
        inner="fit",
        outer=0.7,
        sampling="trilinear",
    )
    monkeypatch.setattr(tuning_series, "MOST_VOXELS", scene.n_voxels // 4)
    coarse = coarser(scene)
    assert coarse.inner == coarse.parameters["boundary_scale"] != scene.inner
    assert coarse.outer / coarse.inner == pytest.approx(0.7)


@pytest.mark.parametrize(
    "name", ["depth_map", "coulomb_drag", "robust", "laplace_only"]
)
def test_another_kind_is_refused(name: str) -> None:
    with pytest.raises(InputError, match=f"{name} cannot be tuned") as refused:
        rows_of(name)
    assert ("no weights" in str(refused.value)) == (name == "laplace_only")


def test_a_place_is_as_large_as_the_probe() -> None:
    """Frames of a place are within its radius of the first; the next one is not."""
    scene = three_presses()
    found = rows_of("eq10").series(10.0)
    position = scene.trajectory.position[contact()]
    first = np.flatnonzero(np.diff(found.place, prepend=-1))
    away = np.linalg.norm(position - position[first[found.place]], axis=1)
    assert away.max() <= scene.shell.rms_radius
    for begins, ends in itertools.pairwise(first):
        far = np.linalg.norm(position[ends] - position[begins])
        assert found.press[ends] != found.press[begins] or far > scene.shell.rms_radius

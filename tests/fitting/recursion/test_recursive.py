import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import chi2

import ttus_opt as tt
from tests.kit import InputError, presses, refuses, small_scene, some, torso
from ttus_opt.contact.rows import contact_rows
from ttus_opt.fitting.recursion.dual_recursion import FIELD_RTOL

WEIGHTS = {"force_weight": 1e-2, "torque_weight": 3e-3}


def batch(scene, frames):
    """The scene with some of its frames, assembled anew."""
    at = np.arange(len(scene.trajectory))[frames]
    return tt.Scene.assemble(
        scene.voxmap,
        scene.shell,
        scene.trajectory.select(at),
        inner=scene.inner,
        outer=scene.outer,
        sampling=scene.sampling,
    )


def fold(fit, trajectory, frames):
    return [
        fit.update(
            trajectory.rotation[t],
            trajectory.position[t],
            trajectory.force[t],
            trajectory.torque[t],
        )
        for t in frames
    ]


def difference(fit, other):
    values = fit.field.values
    return float(np.linalg.norm(values - other) / np.linalg.norm(other))


def speaking(scene):
    """Frames that sample the field; touching the skin alone says nothing."""
    entries = np.diff(scene.N.indptr).reshape(-1, 3).sum(axis=1)
    return np.flatnonzero(entries).tolist()


def closed_form(scene, **options):
    return tt.fit(scene, "eq10", solver="closed_form", **options).field.values


@pytest.mark.parametrize("folded", [0, 5, 12])
def test_equals_the_closed_form_wherever_it_starts(scene, folded):
    start = scene if folded == 12 else batch(scene, slice(max(folded, 1)))
    fit = tt.RecursiveFit(start, **WEIGHTS, fold_scene=folded > 0)
    assert fit.measurements == folded
    innovations = fold(fit, scene.trajectory, list(range(folded, 12)))
    assert [i.index for i in innovations] == list(range(folded, 12))
    assert all(i.accepted and i.in_grid for i in innovations)
    assert fit.measurements == 12
    assert difference(fit, closed_form(scene, **WEIGHTS)) < 1e-10
    assert fit.field.sampling == scene.sampling


@pytest.mark.parametrize(
    "weights",
    [
        {"force_weight": 1e-2, "torque_weight": 0.0},
        {"force_weight": 0.0, "torque_weight": 1e-2},
        {"force_weight": 1e2, "torque_weight": 1e1, "torque_length": 1.0},
    ],
)
def test_other_weights(weights):
    scene = small_scene()
    fit = tt.RecursiveFit(scene, **weights)
    # the field is refined until its dual's residual is below that, not to rounding
    assert difference(fit, closed_form(scene, **weights)) < FIELD_RTOL
    last = fold(fit, scene.trajectory, [0])[0]
    expected = {1e-2: ("fx", "fy", "fz"), 0.0: ("tx", "ty", "tz")}
    if weights["force_weight"] in expected:
        assert last.components == expected[weights["force_weight"]]
    assert last.innovation.shape == (len(last.components),)


@pytest.mark.slow
def test_400_random_measurements_equal_the_batch_fit():
    scene = small_scene("trilinear", n_poses=400)
    order = np.random.default_rng(7).permutation(400).tolist()
    fit = tt.RecursiveFit(scene, **WEIGHTS, fold_scene=False)
    fold(fit, scene.trajectory, order)
    assert fit.measurements == 400
    assert not fit.rejected
    structured = tt.fit(scene, solver="structured", tolerance=1e-9, **WEIGHTS)
    assert difference(fit, structured.field.values) < 1e-8
    assert difference(fit, closed_form(scene, **WEIGHTS)) < 1e-8


@pytest.mark.slow
def test_400_measurements_at_case_s():
    surface = torso()
    scene = tt.Scene.assemble(
        tt.Voxmap.from_surface(surface, shape=(24, 72, 30), r_inner=0.03),
        tt.PointShell.ellipsoid(semi_axes=(0.02, 0.015, 0.015), n_points=1500),
        presses(surface, 400, np.random.default_rng(0)),
        inner=2.0,
        outer=1.5,
        sampling="trilinear",
    )
    fit = tt.RecursiveFit(scene, **WEIGHTS)
    structured = tt.fit(scene, solver="structured", tolerance=1e-9, **WEIGHTS)
    assert difference(fit, structured.field.values) < 1e-8
    rows = 6 * len(fit.in_contact)
    assert fit.memory_bytes < 8 * rows * (rows / 2 + 256) + 100 * scene.n_voxels


def test_downdate_leaves_what_the_others_make():
    scene = small_scene()
    fit = tt.RecursiveFit(scene, **WEIGHTS)
    before = fit.field.values
    gone = fold(fit, scene.trajectory, [4])[0]
    assert difference(fit, before) > 1e-6
    fit.downdate(gone.index)
    assert difference(fit, before) < 1e-12
    fit.downdate(3)
    fit.downdate(0)
    assert fit.measurements == 10
    left = batch(scene, [1, 2, 4, 5, 6, 7, 8, 9, 10, 11])
    assert difference(fit, closed_form(left, **WEIGHTS)) < 1e-10
    refuses(InputError, "measurement 3 is not in the fit", fit.downdate, 3)


def test_window_and_fading():
    scene = small_scene()
    fit = tt.RecursiveFit(scene, **WEIGHTS)
    fit.forget(window=20)
    assert fit.measurements == 12
    fit.forget(window=5)
    assert fit.in_contact == tuple(t for t in speaking(scene) if t >= 7)
    last = batch(scene, slice(7, 12))
    assert difference(fit, closed_form(last, **WEIGHTS)) < 1e-10
    fit.forget(0.25)
    faded = {name: 0.25 * weight for name, weight in WEIGHTS.items()}
    assert difference(fit, closed_form(last, **faded)) < 1e-10
    fit.forget(window=0)
    assert fit.measurements == 0
    laplace = scene.laplace.solve(scene.b).reshape(scene.voxmap.grid.shape)
    assert difference(fit, laplace) < 1e-12


SCENES = {
    "tiny": ("trilinear", (7, 12, 7)),
    "trilinear": ("trilinear", (9, 20, 10)),
    "voxel-mean": ("voxel-mean", (9, 20, 10)),
}


@pytest.mark.parametrize("which", some(SCENES, 1))
def test_innovation_is_predicted_by_the_dense_posterior(which):
    scene = small_scene(*SCENES[which])
    fit = tt.RecursiveFit(scene, **WEIGHTS, noise_std=0.2)
    pose = presses(torso(), 1, np.random.default_rng(99))
    p, length = fit.field.values.reshape(-1), scene.torque_length
    seen = fold(fit, pose, [0])[0]
    L, N, W = (m.toarray() for m in (scene.L, scene.N, scene.W))
    # force noise is 0.2 N; everything else in proportion to the weights
    variance = WEIGHTS["force_weight"] * 0.2**2
    noise = np.repeat([0.2**2, variance * length**2 / WEIGHTS["torque_weight"]], 3)
    Q = L.T @ L + WEIGHTS["force_weight"] * N.T @ N
    Q += WEIGHTS["torque_weight"] / length**2 * W.T @ W
    rows = contact_rows(
        scene.voxmap, scene.shell, pose.rotation, pose.position, sampling=scene.sampling
    )
    h = np.vstack([rows.N.toarray(), rows.W.toarray()])
    covariance = np.diag(noise) + variance * h @ np.linalg.solve(Q, h.T)
    spread = np.sqrt(np.diag(covariance))
    assert np.allclose(
        seen.covariance / np.outer(spread, spread),
        covariance / np.outer(spread, spread),
        atol=1e-6,
    )
    surprise = np.concatenate([pose.force[0], pose.torque[0]]) - h @ p
    assert np.allclose(seen.innovation / spread, surprise / spread, atol=1e-5)
    nis = surprise @ np.linalg.solve(covariance, surprise)
    assert seen.nis == pytest.approx(nis, rel=1e-4)
    assert seen.threshold == pytest.approx(chi2.isf(1e-6, 6))
    assert seen.accepted == (seen.nis <= seen.threshold)


def consistent(scene, std, seed):
    """The scene's poses with wrenches of a field drawn from the prior, and noise."""
    rng = np.random.default_rng(seed)
    scale = np.sqrt(WEIGHTS["force_weight"]) * std
    source = scene.b + scale * rng.normal(size=scene.n_voxels)
    p = scene.laplace.solve(source)
    n = len(scene.trajectory)
    torque_std = scale * scene.torque_length / np.sqrt(WEIGHTS["torque_weight"])
    return replace(
        scene.trajectory,
        force=(scene.N @ p).reshape(n, 3) + std * rng.normal(size=(n, 3)),
        torque=(scene.W @ p).reshape(n, 3) + torque_std * rng.normal(size=(n, 3)),
    )


@pytest.mark.slow
def test_good_measurements_pass_and_their_statistics_are_right():
    scene = small_scene("trilinear", n_poses=150)
    told = consistent(scene, 0.1, 5)
    fit = tt.RecursiveFit(
        scene, **WEIGHTS, noise_std=0.1, outlier_level=1e-4, fold_scene=False
    )
    seen = fold(fit, told, list(range(150)))
    assert len(fit.rejected) <= 1
    # χ² with 6 degrees of freedom: mean 6, standard error √(12/150) = 0.28
    assert np.mean([i.nis for i in seen]) == pytest.approx(6.0, abs=4 * 0.29)
    assert fit.estimated_noise_std == pytest.approx(0.1, rel=0.1)


@pytest.mark.slow
def test_an_outlier_is_reported_and_left_out():
    scene = small_scene("trilinear", n_poses=30)
    told = consistent(scene, 0.1, 6)
    force = told.force.copy()
    force[20] += [3.0, -2.0, 2.0]
    force[25] *= -1.0
    told = replace(told, force=force)
    fit = tt.RecursiveFit(scene, **WEIGHTS, noise_std=0.1, fold_scene=False)
    seen = fold(fit, told, list(range(30)))
    assert fit.rejected == (20, 25)
    assert [i.index for i in seen if not i.accepted] == [20, 25]
    assert all(seen[t].nis > seen[t].threshold for t in (20, 25))
    assert fit.measurements == 28
    kept = [t for t in range(30) if t not in (20, 25)]
    good = batch(replace(scene, trajectory=told), kept)
    assert difference(fit, closed_form(good, **WEIGHTS)) < 1e-10
    refuses(InputError, "measurement 20 is not in the fit", fit.downdate, 20)
    # without a test everything is in
    everything = tt.RecursiveFit(
        scene, **WEIGHTS, noise_std=0.1, outlier_level=None, fold_scene=False
    )
    assert all(i.accepted for i in fold(everything, told, list(range(30))))


def test_a_gross_outlier_is_found_by_the_weights_alone():
    scene = small_scene()
    fit = tt.RecursiveFit(scene, **WEIGHTS)
    told = scene.trajectory
    bad = fit.update(told.rotation[0], told.position[0], [0.0, 900.0, 0.0], np.zeros(3))
    assert not bad.accepted
    assert fit.rejected == (12,)


def test_poses_without_contact_are_held_and_cost_nothing():
    scene = small_scene()
    fit = tt.RecursiveFit(scene, **WEIGHTS)
    before, memory = fit.field.values, fit.memory_bytes
    near = fit.update(np.eye(3), [0.15, 0.0, 0.1], np.full(3, 0.01), np.zeros(3))
    far = fit.update(np.eye(3), [9.0, 0.0, 0.1], np.full(3, 1e3), np.zeros(3))
    assert near.accepted
    assert far.accepted
    assert (near.contact_points, far.contact_points) == (0, 0)
    assert not far.in_grid
    assert far.threshold == np.inf
    assert fit.measurements == 14
    assert fit.in_contact == tuple(speaking(scene))
    assert fit.memory_bytes == memory
    assert np.array_equal(fit.field.values, before)
    fit.downdate(near.index)
    fit.forget(window=3)
    assert fit.measurements == 3
    assert fit.in_contact == (10, 11)


def test_starts_without_wrenches_at_the_laplace_field():
    scene = small_scene()
    bare = replace(scene.trajectory, force=None, torque=None)
    fit = tt.RecursiveFit(replace(scene, trajectory=bare))
    assert fit.measurements == 0
    assert np.isnan(fit.estimated_noise_std)
    laplace = tt.fit(scene, "laplace_only").field.values
    assert difference(fit, laplace) < 1e-10


def test_a_field_once_given_stays():
    scene = small_scene()
    fit = tt.RecursiveFit(scene, **WEIGHTS, fold_scene=False)
    first = fit.field
    copy = first.values.copy()
    fold(fit, scene.trajectory, [0, 1])
    assert difference(fit, copy) > 1e-6
    assert np.array_equal(first.values, copy)


def test_capacity_is_a_limit():
    scene = small_scene()
    frames = speaking(scene)
    n, first = len(frames), frames[0]
    with pytest.raises(InputError, match=f"capacity of {n - 1} measurements"):
        tt.RecursiveFit(scene, **WEIGHTS, capacity=n - 1)
    fit = tt.RecursiveFit(scene, **WEIGHTS, capacity=n)
    refuses(InputError, "forget old measurements", fold, fit, scene.trajectory, [first])
    assert fit.measurements == 12
    fit.forget(window=12 - first - 1)
    assert fold(fit, scene.trajectory, [first])[0].accepted


def test_forces_alone_and_the_noise_they_tell_by_dense_algebra():
    """1/√λ times the root mean square of whitened innovations: the least objective."""
    scene, weight = small_scene("trilinear", shape=(7, 12, 7), n_poses=4), 0.3
    fit = tt.RecursiveFit(
        scene,
        force_weight=weight,
        torque_weight=0.0,
        noise_std=0.2,
        outlier_level=None,
        fold_scene=False,
    )
    both = tt.RecursiveFit(scene, **WEIGHTS, fold_scene=False)
    told = scene.trajectory
    for k in range(4):
        pose = told.rotation[k], told.position[k]
        fit.update(*pose, told.force[k])
        refuses(InputError, r"needs torque \(3,\)", both.update, *pose, told.force[k])
    touching = np.repeat(scene.rows.contact_points > 0, 3)
    D, t = scene.N.toarray()[touching], scene.f[touching]
    M = np.vstack([scene.L.toarray(), np.sqrt(weight) * D])
    side = np.concatenate([scene.b, np.sqrt(weight) * t])
    p = np.linalg.lstsq(M, side)[0]
    np.testing.assert_allclose(
        fit.field.values.reshape(-1), p, atol=1e-7 * np.abs(p).max()
    )
    least = float(np.sum((M @ p - side) ** 2))
    expected = np.sqrt(least / len(t) / weight)
    assert fit.estimated_noise_std == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("option", "message"),
    [
        ({"force_weight": -1e-9}, "force_weight must not be negative"),
        ({"torque_weight": np.inf}, "torque_weight must not be negative"),
        ({"force_weight": 0.0, "torque_weight": 0.0}, "both weights are 0"),
        ({"torque_length": 0.0}, "torque_length must be positive"),
        ({"torque_length": np.nan}, "torque_length must be positive"),
        ({"capacity": 0}, "at least 1 measurement"),
        ({"outlier_level": 0.0}, "a probability between 0 and 1"),
        ({"outlier_level": 1.0}, "a probability between 0 and 1"),
        ({"noise_std": 0.0}, "noise_std must be positive"),
        ({"noise_std": np.inf}, "noise_std must be positive"),
    ],
)
def test_options_are_checked(option, message):
    refuses(InputError, message, tt.RecursiveFit, small_scene(), **option)


def test_options_at_the_ends_of_their_ranges_are_taken():
    """One weight may be 0; one measurement is a capacity; 1e-12 is a probability."""
    weights = ({"force_weight": 0.0}, {"torque_weight": 0.0})
    more = {"noise_std": 1e-9}, {"outlier_level": 1e-12}, {"capacity": 1}
    for options in (*weights, *more):
        tt.RecursiveFit(small_scene(), fold_scene=False, **options)


@functools.cache
def held():
    """A fit for what changes nothing."""
    return tt.RecursiveFit(small_scene(), **WEIGHTS)


@pytest.mark.parametrize(
    ("argument", "value", "message"),
    [
        (0, np.eye(4), r"rotation \(3, 3\), got shape \(4, 4\)"),
        (0, 2.0 * np.eye(3), "orthonormal"),
        (0, np.diag([1.0, 1.0, -1.0]), "reflection"),
        (1, np.zeros(2), r"position \(3,\)"),
        (1, np.array([np.nan, 0.0, 0.0]), "NaN"),
        (2, np.array([np.inf, 0.0, 0.0]), "force .* infinity"),
        (3, np.zeros((3, 1)), r"torque \(3,\)"),
    ],
)
def test_measurements_are_checked(argument, value, message):
    fit = held()
    arguments = [np.eye(3), np.array([0.12, 0.0, 0.1]), np.zeros(3), np.zeros(3)]
    arguments[argument] = value
    refuses(InputError, message, fit.update, *arguments)
    assert fit.measurements == 12


@pytest.mark.parametrize(
    ("factor", "window"), [(None, None), (0.5, 3), (0.0, None), (1.5, None), (None, -1)]
)
def test_forget_wants_one_sound_value(factor, window):
    refuses(InputError, r"factor|window", held().forget, factor, window=window)


def test_forgetting_nothing_and_everything():
    scene = small_scene()
    fit = tt.RecursiveFit(scene, **WEIGHTS)
    touching = f"12 measurements held, {len(speaking(scene))} in contact>"
    assert repr(fit) == f"<RecursiveFit on {scene.voxmap.grid.sizes}: {touching}"
    before = fit.field.values
    for nothing in ({"factor": 1.0}, {"window": 12}, {"window": 20}):
        fit.forget(**nothing)
        assert difference(fit, before) < 1e-12
        assert fit.measurements == 12
    fit.forget(window=0)
    assert difference(fit, tt.fit(scene, "laplace_only").field.values) < 1e-10
    assert fit.measurements == 0

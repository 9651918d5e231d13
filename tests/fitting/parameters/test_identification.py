"""Parameters beside the field: standard errors, and what the data do not bear.

Standard errors of real fits against dense fits with one place left out.
"""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import dragged_scene, small_scene, some, with_wrenches
from tests.oracles.dense import least_squares, stacked
from ttus_opt.contact.friction import Sliding
from ttus_opt.fitting.parameters.identification import PlaceRows, noise_variance
from ttus_opt.problem.formulation import load

SMALL = (8, 18, 9)
WEIGHTS = {"force_weight": 1e-2, "torque_weight": 1e-2}
NEUTRAL = {
    "coulomb_global": {"friction_coefficient"},
    "viscous_drag": {"viscous_coefficient"},
    "coulomb_drag": {"friction_coefficient", "mean_friction_coefficient"},
}
each_drag = pytest.mark.parametrize("name", sorted(NEUTRAL))


def recorded(scene, trajectory):
    """The same torso with another recording."""
    return tt.Scene.assemble(
        scene.voxmap,
        scene.shell,
        trajectory,
        inner=3.0,
        outer=3.0,
        sampling="trilinear",
    )


def away(given):
    return replace(given, position=given.position * [1.3, 1.3, 1.0])


def still(given):
    n = len(given)
    return replace(
        given,
        position=np.repeat(given.position[:1], n, axis=0),
        rotation=np.repeat(given.rotation[:1], n, axis=0),
    )


def alone(given):
    return tt.Trajectory(
        given.time[:1],
        given.position[:1],
        given.rotation[:1],
        given.force[:1],
        given.torque[:1],
    )


def dragged():
    return dragged_scene("contact", shape=SMALL)


@pytest.mark.filterwarnings("ignore::ttus_opt.core.errors.TtusWarning")
@pytest.mark.parametrize(
    ("change", "reason"),
    [(away, "no contact"), (still, "no sliding"), (alone, "no sliding")],
    ids=["away", "still", "alone"],
)
@each_drag
def test_nothing_slides_and_nothing_is_invented(name, change, reason):
    """It gave μ = 0.9996, 0.59 and 0.9996, solved and silent."""
    scene = recorded(dragged(), change(dragged().trajectory))
    solution = tt.fit(scene, name, **WEIGHTS)
    assert solution.status is tt.Status.SOLVED, solution.advice
    assert set(solution.not_identified) == NEUTRAL[name]
    for parameter in NEUTRAL[name]:
        assert solution.not_identified[parameter] == reason
        assert solution.parameters[parameter] == 0.0
        assert solution.field.parameters[parameter] == 0.0
        line = f"{parameter}: not identified ({reason}): 0 is used"
        assert line in solution.identified
    assert not NEUTRAL[name] & set(solution.standard_errors)
    if name != "coulomb_drag":  # which keeps p ≥ 0
        plain = tt.fit(scene, "eq10", **WEIGHTS)
        np.testing.assert_allclose(solution.field.values, plain.field.values, atol=1e-6)


@each_drag
def test_a_pure_press_tells_no_drag(name):
    """Up and down along the probe's axis, a tracker's 2 µm to the sides."""
    given = still(dragged().trajectory)
    sliding = Sliding.of(dragged().voxmap, dragged().shell, given, "reference")
    out = given.rotation[0] @ sliding.axis
    rng = np.random.default_rng(5)
    deep = 0.002 * np.sin(0.5 * np.arange(len(given)))[:, None]
    aside = rng.normal(0.0, 2e-6, (len(given), 3))
    pressed = replace(given, position=given.position + deep * out + aside)
    scene = recorded(dragged(), pressed)
    p = scene.laplace.solve(scene.b)
    force = scene.N @ p + rng.normal(0.0, 0.3, scene.f.shape)
    torque = scene.W @ p + rng.normal(0.0, 5e-3, scene.f.shape)
    scene = with_wrenches(scene, force, torque)
    solution = tt.fit(scene, name, acts_at="reference", **WEIGHTS)
    assert set(solution.not_identified) == NEUTRAL[name]
    for parameter in NEUTRAL[name]:
        assert solution.parameters[parameter] == 0.0
        assert " ± " in solution.not_identified[parameter]  # slid on, but hardly


each_parameter = pytest.mark.parametrize(
    ("name", "parameter", "truth"),
    [
        ("coulomb_global", "friction_coefficient", 0.3),
        ("coulomb_drag", "friction_coefficient", 0.3),
        ("coulomb_drag", "mean_friction_coefficient", 0.3),
        ("viscous_drag", "viscous_coefficient", 20.0),
    ],
)


@each_parameter
def test_a_good_sweep_tells_drag(name, parameter, truth):
    viscous = name == "viscous_drag"
    scene = noisy(made(viscous), 1e-3, np.random.default_rng(1))
    solution = tt.fit(scene, name, acts_at="contact", **WEIGHTS)
    error = solution.standard_errors[parameter]
    assert parameter not in solution.not_identified
    assert 0.0 < error < 0.1 * truth
    assert solution.parameters[parameter] == pytest.approx(truth, abs=3.0 * error)
    assert solution.field.standard_errors == solution.standard_errors


def made(viscous):
    drag = {"mu": 0.0, "viscous": 20.0} if viscous else {"mu": 0.3}
    return dragged_scene("contact", shape=SMALL, **drag)


def noisy(scene, sigma, rng):
    """A draw from the model: a field from its prior, measurements with their noise.

    The drag of the scene's own wrenches acts on the Laplace field, its part on the
    rest of the drawn field is left out.
    """
    shift = scene.laplace.solve(sigma * rng.normal(size=scene.n_voxels))
    noise = sigma / np.sqrt(WEIGHTS["force_weight"])
    force, torque = noise * rng.normal(size=(2, len(scene.f)))
    return with_wrenches(
        scene,
        scene.f + scene.N @ shift + force,
        scene.tau + scene.W @ shift + scene.torque_length * torque,
    )


def test_the_noise_is_estimated_from_what_is_left():
    """σ̂² has the expectation σ² whatever λ says, frames off the skin left out."""
    sigma, scene = 1e-3, made(viscous=True)
    far = scene.trajectory.position.copy()
    far[::4] *= [1.3, 1.3, 1.0]
    assert scene.trajectory.force is not None
    scene = recorded(scene, replace(scene.trajectory, position=far))
    declared = load("eq10", scene, **WEIGHTS)
    fitter = tt.Fitter(declared)
    p = scene.laplace.solve(scene.b)
    scene = with_wrenches(scene, scene.N @ p, scene.W @ p)
    rng, found = np.random.default_rng(0), []
    for _ in range(5):
        drawn = load("eq10", noisy(scene, sigma, rng), **WEIGHTS)
        fitter.update(drawn)
        solution = fitter.solve()
        found.append(noise_variance(drawn, solution, 0))
    # 45 poses of 6 rows, five draws: 4 %
    assert np.mean(found) == pytest.approx(sigma**2, rel=0.15)


@pytest.mark.slow
def test_a_viscous_standard_error_is_that_of_dense_least_squares():
    """With all rows in one matrix, one patch and several."""
    scene = noisy(made(viscous=True), 1e-3, np.random.default_rng(2))
    place = scene.places
    alike = np.random.default_rng(6).normal(0.0, 0.03, (len(place), 3))[place]
    scene = with_wrenches(scene, scene.f + alike.ravel())
    for patches in (1, 12):
        solution = tt.fit(
            scene, "viscous_drag", acts_at="contact", sectors=patches, **WEIGHTS
        )
        program = solution.program
        M, t = stacked(program)
        A = M.toarray()
        V = scene.n_voxels
        slid = V + np.flatnonzero(np.abs(A[:, V:]).sum(axis=0))
        columns = np.concatenate([np.arange(V), slid])
        x = np.linalg.solve(A[:, columns].T @ A[:, columns], A[:, columns].T @ t)
        rest = t - A[:, columns] @ x
        speaks = int((np.abs(A[V:]).sum(axis=1) > 0.0).sum())
        variance = float(rest @ rest) / (speaks - len(slid))
        gram = A[:, columns].T @ A[:, columns]
        inverse = np.linalg.inv(gram)[V:, V:]
        usual = np.sqrt(variance * np.diagonal(inverse))
        # the rows' derivatives along the profile, with the field fitted anew
        G, B = A[:, slid], A[:, :V]
        along = G - B @ np.linalg.solve(B.T @ B, B.T @ G)
        rows = PlaceRows.of(scene, program)
        own = np.concatenate([V + rows.rows, V + 3 * len(scene.trajectory) + rows.rows])
        expected = rows.errors(
            usual, -rest[own], along[own] @ (0.5 * inverse), 0.5 * np.diagonal(inverse)
        ).errors
        if patches == 1:
            told = solution.standard_errors["viscous_coefficient"]
            assert told == pytest.approx(expected[0], rel=1e-4)
            continue
        assert len(slid) > 1
        for k, column in enumerate(slid - V):
            told = solution.standard_errors[f"viscous_coefficient_{column}"]
            assert told == pytest.approx(expected[k], rel=1e-4)
        assert (expected > 1.01 * usual).any()
        untouched = set(range(patches)) - set((slid - V).tolist())
        for i in untouched:
            reason = solution.not_identified[f"viscous_coefficient_{i}"]
            assert reason == "never touched, as the mean of the others"
            mean = solution.parameters["viscous_coefficient"]
            assert solution.parameters[f"viscous_coefficient_{i}"] == mean


@pytest.mark.slow
def test_a_searched_standard_error_is_that_of_the_dense_profile():
    """J(μ) by dense least squares at other places, its second difference by hand."""
    scene = noisy(made(viscous=False), 1e-3, np.random.default_rng(3))
    solution = tt.fit(scene, "coulomb_global", acts_at="contact", **WEIGHTS)
    found = solution.parameters["friction_coefficient"]
    declared = load("coulomb_global", scene, acts_at="contact", **WEIGHTS)
    build = declared.search.build

    def least(mu):
        M, t = stacked(build(mu).compile())
        rest = t - M @ least_squares(M, t)
        return float(rest @ rest)

    h = 0.01
    low, J, high = (least(found + d) for d in (-h, 0.0, h))
    assert abs(low - high) < 0.05 * (low + high - 2.0 * J)  # it is the minimum
    frames = int((scene.rows.contact_points > 0).sum())
    curvature = (low - 2.0 * J + high) / h**2
    expected = np.sqrt(2.0 * J / (6 * frames - 1) / curvature)
    told = solution.standard_errors["friction_coefficient"]
    assert told == pytest.approx(expected, rel=0.02)


def spread_of(name, parameter, draws):
    """Spread and mean of an estimate over draws, and the standard error it tells."""
    scene, rng = made(name == "viscous_drag"), np.random.default_rng(7)
    values, errors = [], []
    for _ in range(draws):
        drawn = noisy(scene, 1e-3, rng)
        solution = tt.fit(drawn, name, acts_at="contact", **WEIGHTS)
        values.append(solution.parameters[parameter])
        errors.append(solution.standard_errors[parameter])
    return float(np.std(values)), float(np.mean(values)), float(np.mean(errors))


@pytest.mark.slow
@each_parameter
def test_estimates_spread_as_told(name, parameter, truth):
    spread, mean, told = spread_of(name, parameter, 40)
    assert told / 1.5 < spread < told * 1.5
    assert abs(mean - truth) < 4.0 * told / np.sqrt(40)


def test_several_patches_are_doubted_one_by_one():
    """A patch that is hardly slid on has 0, the others are as they were without it."""
    scene = noisy(made(viscous=True), 1e-3, np.random.default_rng(2))
    given = scene.trajectory
    louder = given.force.copy()
    rng = np.random.default_rng(0)
    angle = np.arctan2(given.position[:, 1], given.position[:, 0])
    hidden = (angle % (2 * np.pi)) > np.deg2rad(90.0)
    louder[hidden] += rng.normal(0.0, 0.5, louder[hidden].shape)
    scene = with_wrenches(scene, louder)
    solution = tt.fit(scene, "viscous_drag", acts_at="contact", sectors=12, **WEIGHTS)
    unidentified = {n for n, why in solution.not_identified.items() if "±" in why}
    for name in unidentified:
        assert solution.parameters[name] == 0.0
        assert name not in solution.standard_errors
    known = set(solution.standard_errors)
    each = {n for n in solution.parameters if n.startswith("viscous_coefficient")}
    assert known | set(solution.not_identified) == each


@pytest.mark.slow
def test_a_value_at_its_lower_limit_is_a_statement():
    """Frictionless data with good sliding: μ = 0, told, with its standard error."""
    scene = dragged_scene("contact", mu=-0.1, shape=SMALL)  # it pushes along
    scene = noisy(scene, 1e-3, np.random.default_rng(4))
    for name in sorted(NEUTRAL):
        solution = tt.fit(scene, name, acts_at="contact", **WEIGHTS)
        assert not solution.not_identified
        for parameter in NEUTRAL[name]:
            if name == "coulomb_drag":
                # of a field with noise, here and there above its limit
                assert 0.0 <= solution.parameters[parameter] < 5e-3
                continue
            assert solution.parameters[parameter] == pytest.approx(0.0, abs=1e-6)
            assert solution.remarks[parameter] == "at its lower limit 0"
            assert solution.standard_errors[parameter] > 0.0
            told = [k for k in solution.identified if k.startswith(parameter + " ")]
            assert told[0].endswith("(at its lower limit 0)")


@pytest.mark.parametrize("name", some(["coulomb_global", "coulomb_drag"], 1))
def test_a_value_at_its_upper_limit_is_none(name):
    """True μ is 0.3, at most 0.2 is allowed: named, and neutral."""
    scene = noisy(made(viscous=False), 1e-3, np.random.default_rng(4))
    solution = tt.fit(scene, name, acts_at="contact", largest_friction=0.2, **WEIGHTS)
    assert "mean_friction_coefficient" in (
        *solution.not_identified,
        "mean_friction_coefficient" if name == "coulomb_global" else "",
    )
    why = solution.not_identified.values()
    assert "at its upper limit 0.2" in why
    assert solution.status is tt.Status.SOLVED


def test_standard_errors_go_through_the_file(tmp_path):
    scene = noisy(made(viscous=True), 1e-3, np.random.default_rng(1))
    field = tt.fit(scene, "viscous_drag", **WEIGHTS).field
    field.save(tmp_path / "field.nc")
    back = tt.PotentialField.load(tmp_path / "field.nc")
    assert back.standard_errors == field.standard_errors
    assert back.standard_errors["viscous_coefficient"] > 0.0


def test_without_weight_nothing_is_told():
    scene = made(viscous=True)
    for name in ("coulomb_global", "viscous_drag"):
        solution = tt.fit(scene, name, force_weight=0.0, torque_weight=0.0)
        assert set(solution.not_identified) == NEUTRAL[name]
        assert all(solution.parameters[parameter] == 0.0 for parameter in NEUTRAL[name])


@each_drag
def test_forces_that_are_all_zero_do_not_trouble_it(name):
    nothing = np.zeros_like(dragged().f)
    scene = with_wrenches(dragged(), nothing, nothing).with_boundary(0.0, 0.0)
    solution = tt.fit(scene, name, **WEIGHTS)
    told = {*solution.standard_errors, *solution.not_identified, *solution.remarks}
    assert told == NEUTRAL[name]
    for parameter in solution.not_identified:
        assert solution.parameters[parameter] == 0.0


def test_a_depth_map_lists_no_scale_of_boundary_values_that_it_does_not_use():
    scene = small_scene("trilinear", n_poses=30)
    fitted = tt.Scene.assemble(
        scene.voxmap, scene.shell, scene.trajectory, inner="fit", sampling="trilinear"
    )
    assert set(fitted.standard_errors) == {"boundary_scale"}
    solution = tt.fit(fitted, "depth_map")
    for found in (solution, solution.field):
        assert not found.parameters and not found.standard_errors
    unidentified = replace(fitted, not_identified={"boundary_scale": "no contact"})
    solution = tt.fit(unidentified, "depth_map")
    assert not solution.not_identified and not solution.identified
    assert tt.fit(unidentified, "eq10").not_identified == unidentified.not_identified


NOISE = 0.02


def unlike_places(shared):
    """Drag that is a part stronger or weaker at every place, and sensor noise."""
    whole = dragged_scene("contact", shape=(8, 18, 9), n=90)
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
def test_friction_varies_as_without_a_place():
    scene = unlike_places(shared=0.3)
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
    scene = unlike_places(shared=0.0)
    far = scene.trajectory.position.copy()
    far[10:14] *= [1.3, 1.3, 1.0]
    away = replace(scene.trajectory, position=far)
    scene = tt.Scene.assemble(scene.voxmap, scene.shell, away, inner=3.0, outer=3.0)
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

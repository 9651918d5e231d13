"""Torsos that are drawn, spoiled recordings, and what chance gives of coverage."""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import ttus_opt as tt
from ttus_opt import example
from ttus_opt.fitting.weights.weight_choice import default_model

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def scripts():
    """The scripts, by name."""
    sys.path.insert(0, str(FOLDER))
    import coverage_at_places
    import torsos
    import truth_spoiled

    yield {s.__name__: s for s in (coverage_at_places, torsos, truth_spoiled)}
    sys.path.remove(str(FOLDER))


@pytest.fixture(scope="module")
def recordings():
    """Skin and recordings of the bundled example."""
    surface = tt.Surface.load(example.path("surface.nc"))
    names = "press_fit.csv", "sweep_fit.csv"
    return surface, [tt.read_trajectory(example.path(name)) for name in names]


@pytest.mark.parametrize("number", range(4))
def test_a_number_makes_a_torso_that_is_pressed_within_its_patch(scripts, number):
    torsos = scripts["torsos"]
    drawn, again = (torsos.Drawn.of(np.random.default_rng(number)) for _ in range(2))
    assert drawn == again != torsos.Drawn.of(np.random.default_rng(number + 1))
    low, high = torsos.SOFT
    assert low <= drawn.torso.soft <= high
    rng = np.random.default_rng(number)
    wide = torsos.presses(rng, 100, drawn.side, 1.0), torsos.sweep(rng, drawn.side)
    for handling in wide:
        poses = handling.poses(drawn.torso, drawn.probe)
        shell = tt.PointShell.ellipsoid(drawn.probe.semi_axes)
        below = poses.position[:, None] + np.einsum(
            "tij,mj->tmi", poses.rotation, shell.points
        )
        x, y, z = np.moveaxis(below, -1, 0)
        theta = np.arctan2(y, x)
        inside = np.hypot(x, y) < drawn.torso.radius(theta, z)
        for values, (least, most) in (
            (theta, torsos.MESH.theta),
            (z, torsos.MESH.z),
        ):
            assert least < values[inside].min() < values[inside].max() < most
        depth = (drawn.torso.radius(theta, z) - np.hypot(x, y)).max(axis=1)
        assert 0.004 < depth.max() < 0.02


def test_presses_are_as_deep_and_as_far_aside_as_is_said(scripts):
    torsos = scripts["torsos"]
    handling = torsos.presses(np.random.default_rng(0), 50, 0.06, 2.0)
    assert len(handling.time) == 50 * 40
    each = handling.depth.reshape(50, 40)
    assert np.all(each[:, 0] == -0.002)  # lifted between presses
    deepest = each.max(axis=1)
    assert np.all(abs(deepest - 0.0096) < 0.0024 + 1e-9)
    assert np.ptp(handling.across) > 0.1
    assert np.all(np.abs(handling.across) <= 0.06)
    assert np.all(np.ptp(handling.across.reshape(50, 40), axis=1) == 0.0)


def test_what_is_wrong_is_what_is_said(scripts, recordings):
    script = scripts["truth_spoiled"]
    skin, read = recordings
    shell = tt.PointShell.from_spec(example.PROBE)

    def spoiled(name):
        torso = script.Torso(skin, shell, read, np.random.default_rng(0))
        other, own = script.SPOILS[name](torso)
        return other.radius - skin.radius, own

    moved, same = spoiled("nothing")
    assert not moved.any() and same == read
    for name, metres in (
        ("a skin 3 mm too low", -3e-3),
        ("a skin 3 mm too high", 3e-3),
    ):
        moved, same = spoiled(name)
        np.testing.assert_allclose(moved, metres, atol=1e-12)
        assert same == read
    moved, _ = spoiled("a skin with bumps of 2 mm")
    assert moved.std() == pytest.approx(2e-3)
    off = spoiled("a sensor 0.3 N off zero")[1][0].force - read[0].force
    np.testing.assert_allclose(np.linalg.norm(off, axis=1), 0.3)
    for name, metres in (("0.7 mm", 7e-4), ("1.5 mm", 1.5e-3)):
        off = spoiled(f"a tracker's noise of {name}")[1][0].position - read[0].position
        assert off.std() == pytest.approx(metres, rel=0.5)
    assert spoiled("presses alone")[1] == read[:1]
    assert spoiled("a sweep alone")[1] == read[1:]
    assert spoiled("three presses alone")[1][0].time.max() < 6.0
    depths = scripts["coverage_at_places"].depths
    (pressed,) = spoiled("contacts of 3 mm alone")[1]  # the sweep is deeper
    deepest = depths(skin, shell, pressed).max()
    assert 0.002 < deepest < 0.003 < 0.01 < depths(skin, shell, read[0]).max()
    assert all(
        (one.position[:, 0] > 0.0).all() for one in spoiled("the left side alone")[1]
    )
    assert np.median(np.diff(spoiled("5 Hz")[1][0].time)) == pytest.approx(0.2)
    assert all(one.torque is None for one in spoiled("forces alone")[1])


def test_a_line_of_what_is_wrong_by_hand(scripts):
    rows = {
        "nothing": {"a": {"press": {"covered": 0.9, "default": 0.1, "r:x": 0.2}}},
        "5 Hz": {
            "a": {"press": {"covered": 0.7, "default": 0.3, "r:x": 0.2, "y": 0.4}}
        },
    }
    nothing, slow = scripts["truth_spoiled"].table(rows).splitlines()[2:]
    assert nothing == "| nothing | 1 | 1.00 | 0.50, 0.50 | 0 | 0 |"
    assert slow == "| 5 Hz | 1 | 3.00 | 1.50, 1.50 | 1 | 1 |"


@pytest.fixture(scope="module")
def stated(recordings):
    """A coarse fit of the example, its scene and its uncertainty."""
    skin, read = recordings
    voxmap = tt.Voxmap.from_surface(skin, shape=(16, 36, 18), r_inner=0.05)
    shell = tt.PointShell.from_spec(example.PROBE)
    scene = tt.Scene.assemble(voxmap, shell, tt.Trajectory.concatenate(read))
    choice = default_model(scene)
    solution = tt.fit(choice.scene, choice.formulation)
    return choice.scene, tt.uncertainty(solution, choice.scene)


def test_errors_are_drawn_with_the_stated_covariance(scripts, stated):
    coverage, (scene, own) = scripts["coverage_at_places"], stated
    path = tt.read_trajectory(example.path("press_test.csv")).select(slice(None, 400))
    known = own.std(path).covariance[:, :3, :3]
    draws = own.draws(coverage.DRAWS, coverage.DEPTH)
    errors = coverage.drawn_errors(own, scene, path, draws, np.random.default_rng(1))
    found = np.einsum("tik,tjk->tij", errors, errors) / coverage.DRAWS
    sizes = np.einsum("tii->t", known), np.einsum("tii->t", found)
    pressed = sizes[0] > 1e-2 * sizes[0].max()
    ratio = sizes[1][pressed] / sizes[0][pressed]
    assert pressed.sum() > 50
    assert ratio.mean() == pytest.approx(1.0, abs=0.15)
    assert np.all(abs(np.log(ratio)) < np.log(2.0))
    # frames of one press err alike
    middle = np.flatnonzero(pressed)[:2]
    alike = np.corrcoef(np.linalg.norm(errors[middle], axis=1))
    assert alike[0, 1] > 0.8


def test_what_chance_gives_is_what_independent_errors_have(scripts):
    coverage, rng = scripts["coverage_at_places"], np.random.default_rng(0)
    errors = rng.standard_normal((400, 1 + coverage.DRAWS))
    nothing = np.zeros(400, dtype=bool)
    own = coverage.Judged(
        errors[:, 0], np.ones(400), np.zeros(400), nothing, nothing, errors[:, 1:]
    )
    bands = np.stack([own.figures(np.arange(400) // 100 == k) for k in range(4)])
    assert bands.shape == (4, 3, 1 + coverage.DRAWS)
    covered, error, std = bands.mean(axis=(0, 2))
    assert covered == pytest.approx(0.95, abs=0.005)
    assert std / error == pytest.approx(np.sqrt(np.pi / 2.0), abs=0.01)
    wide = replace(own, std=np.full(400, 2.0))
    told = coverage.summary(np.stack([wide.figures(~nothing)] * 3)).splitlines()
    assert told[0] == "3 bands: found; were the errors drawn from what is stated"
    assert told[2] == "bands below 90 %: 0; 0 (0 to 0)"
    assert told[4] == "bands where it is above 1.5: 3; 3 (3 to 3)"

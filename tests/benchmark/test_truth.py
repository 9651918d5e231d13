"""The table of the default against all others: `benchmarks/truth.py`."""

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import ttus_opt as tt
from ttus_opt import example

FOLDER = Path(__file__).resolve().parents[2] / "benchmarks"
SHAPE = ["--shape", "12", "24", "12"]
#: Contacts to fit a law to
N = 150


@pytest.fixture(scope="module")
def truth():
    """The script, with its table."""
    sys.path.insert(0, str(FOLDER))
    import truth

    yield truth
    sys.path.remove(str(FOLDER))


@pytest.fixture
def contacts(truth):
    """Contacts on a patch of 60 mm, the last 40 to judge by."""
    rng = np.random.default_rng(3)
    place = np.c_[rng.uniform(-30.0, 30.0, (N + 40, 2)), np.zeros(N + 40)]
    direction = rng.normal([0.0, 0.0, 4.0], 1.0, (N + 40, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    return truth.Contacts(rng.uniform(2.0, 20.0, N + 40), place, direction)


def judged(rival, contacts, force):
    """Largest error where nothing was fitted, over the mean force."""
    law = rival(contacts[:N], force[:N])
    return np.abs(law(contacts[N:]) - force[N:]).max() / force.mean()


def test_a_spring_is_recovered(truth, contacts):
    assert judged(truth.linear_spring, contacts, 0.4 * contacts.depth) < 1e-12
    other = 0.4 * contacts.depth**2  # then by least squares
    stiffness = np.linalg.lstsq(contacts.depth[:, None], other, rcond=None)[0]
    law = truth.linear_spring(contacts, other)
    np.testing.assert_allclose(law(contacts), stiffness * contacts.depth)


def test_the_nearest_has_both_place_and_depth(truth):
    place = np.zeros((4, 3))
    place[2:, 0] = 50.0
    depth, force = np.array([4.0, 8.0, 4.0, 8.0]), np.array([1.0, 2.0, 3.0, 4.0])
    x = truth.Contacts(depth, place, np.zeros((4, 3)))
    y = truth.Contacts(depth + 1.5, place + 9.0, np.zeros((4, 3)))
    assert truth.nearest_neighbour(x, force)(y).tolist() == [1.0, 2.0, 3.0, 4.0]


def test_a_power_law_is_recovered(truth, contacts):
    force = 0.1 * contacts.depth**1.7
    for rival in (truth.kriged_power_law, truth.gaussian_process):
        assert judged(rival, contacts, force) < 1e-9


def kernel(truth, at, centres):
    """Matérn 3/2 without unit."""
    far = np.sqrt(3.0) * truth.distance(at, centres)
    return (1.0 + far) * np.exp(-far)


@pytest.mark.slow
def test_a_law_that_varies_as_the_process_says_is_recovered(
    truth, contacts, monkeypatch
):
    """A law whose mean is c hᵃ exactly, its centres among what is fitted.

    It is recovered exactly with its own lengths, closely with lengths by evidence.
    """
    length, deep, turn = (values[6] for values in truth.LENGTHS)
    place = contacts.place / length
    pose = np.c_[place, contacts.depth / deep, contacts.direction / turn]
    power = contacts.depth**1.3
    for rival, at in ((truth.kriged_power_law, place), (truth.gaussian_process, pose)):
        share = np.zeros(N)
        share[:6] = [0.3, -0.2, 0.25, -0.3, 0.2, 0.1]
        near = kernel(truth, at, at[:N])
        # the mean that is fitted by least squares is then the law's own
        waves = near[:N] @ share * power[:N]
        mean = near[:N] @ np.eye(N)[6] * power[:N]
        share[6] = -(power[:N] @ waves) / (power[:N] @ mean)
        force = power * (1.0 + near @ share)
        assert np.abs(near[N:] @ share).max() > 0.15  # no power law alone
        assert judged(rival, contacts, force) < 5e-3
        with monkeypatch.context() as own:
            own.setattr(truth, "LENGTHS", ([length], [deep], [turn]))
            own.setattr(truth, "NOISES", [1e-6])
            assert judged(rival, contacts, force) < 1e-6


@pytest.mark.slow
def test_a_table_of_the_bundled_example_is_kept_and_continued(truth, tmp_path, capsys):
    kept, page, dots = tmp_path / "kept", tmp_path / "t.md", tmp_path / "t.png"
    asked = ["--results", str(kept), "--cases", "example", *SHAPE]
    models = ["--models", "laplace_only", "r:linear_spring"]
    output = ["--output", str(page), "--picture", str(dots)]
    truth.main([*asked, *models, *output])
    told = capsys.readouterr()
    assert page.read_text() == told.out and dots.stat().st_size > 1000
    assert told.err.count("\n") == 3 and "`r:linear_spring` | 0." in told.out
    truth.main([*asked, "--models", "r:linear_spring", "r:kriged_power_law", "--json"])
    again = capsys.readouterr()
    assert again.err.splitlines()[0].startswith("example r:kriged_power_law")
    found = json.loads(again.out)
    rows = found["results"]["example"]
    assert list(rows) == ["default", "r:linear_spring", "r:kriged_power_law"]
    errors = {m: r["scores"]["press"]["error_N"] for m, r in rows.items()}
    ratio = found["against"]["r:linear_spring"]["wins"]["example press"]
    assert ratio == errors["default"] / errors["r:linear_spring"] < 1.0
    # another shape is another result, and one with another stamp is computed again
    stamp = rows["default"]["stamp"]
    assert truth.cases(None, None, None, None, (12, 24, 14))[0][0].stamp() != stamp
    file = kept / "example.json"
    file.write_text(file.read_text().replace(stamp, "old", 1))
    truth.main([*asked, "--models", "r:linear_spring"])
    assert capsys.readouterr().err.startswith("example default")


def test_scores_are_over_the_frames_of_each_kind(truth, tmp_path):
    for name in ("surface.nc", "press_fit.csv"):
        shutil.copy(example.path(name), tmp_path)
    own = tmp_path, ("press_fit.csv",), {"press": "press_fit.csv"}
    force = tt.read_trajectory(tmp_path / "press_fit.csv").force
    size = np.linalg.norm(force, axis=1)
    np.savetxt(tmp_path / "scored.txt", rows := np.argsort(size)[-20:], "%d")
    torso = truth.Case("a", *own, "phantoms", (9, 9, 9)).score("press", 0.9 * force)
    tissue = truth.Case("a", *own, "tissue", (9, 9, 9)).score("press", 0.9 * force)
    touching = size > 0.5
    assert torso["error_N"] == pytest.approx(0.1 * size[touching].mean())
    assert torso["off_percent"] == pytest.approx(100.0 * (size > 3.6)[touching].mean())
    assert torso["frames"] == touching.sum() > 20 == tissue["frames"]
    assert tissue["error_N"] == pytest.approx(0.1 * size[rows].mean())


def test_frames_of_a_press_are_one_sample(truth):
    time = np.r_[0.0:1.0:0.1, 1.0:6.0:0.1]
    at = np.zeros((60, 3))
    at[10:] = 0.02  # the second press is elsewhere, and lasts 5 s
    force = np.ones((60, 3))
    poses = tt.Trajectory(time, at, np.tile(np.eye(3), (60, 1, 1)), force, force)
    judged = np.ones(60, dtype=bool)
    assert np.bincount(truth.stretches(poses, judged)).tolist() == [10, 20, 20, 10]
    judged[30:40] = False  # a pause ends it, too
    assert np.bincount(truth.stretches(poses, judged)).tolist() == [10, 20, 20]


def test_a_standard_error_is_that_of_presses_drawn_again(truth):
    import truth_table

    rng = np.random.default_rng(0)
    frames = rng.integers(5, 40, 50)
    one, other = (frames * rng.gamma(4.0, 0.02, 50) for _ in range(2))
    rows = [
        {"frames_of_stretches": frames, "errors_of_stretches_N": e}
        for e in (one, other)
    ]
    drawn = rng.integers(50, size=(20_000, 50))
    means = (one - other)[drawn].sum(axis=1) / frames[drawn].sum(axis=1)
    assert truth_table.standard_error(*rows) == pytest.approx(means.std(), rel=0.03)
    single = [{name: values[:1] for name, values in row.items()} for row in rows]
    assert np.isnan(truth_table.standard_error(*single))


def test_losses_and_wins_by_hand(truth):
    found = {
        "a press": {"default": 0.2, "eq10": 0.1, "r:x": 0.8},
        "b tissue": {"default": 0.1, "eq10": 0.104, "r:x": 0.2},
    }
    told = truth.against(found)
    assert told["eq10"]["mean_ratio"] == pytest.approx((2.0 / 1.04) ** 0.5)
    assert (told["eq10"]["loses"], told["eq10"]["wins"]) == ({"a press": 2.0}, {})
    assert list(told["r:x"]["wins"]) == ["a press", "b tissue"]
    assert told["best"]["loses"] == {"a press": 2.0}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--models", "eq11"], "no model eq11"),
        (["--models", "c:stiffness_map@trilinear"], "no model c:stiffness_map"),
        (["--cases", "phantom"], "no case phantom.*give --phantoms"),
        (["--cases", "tissue", "--tissue", "."], "no case tissue.*scored.txt in"),
    ],
)
def test_what_is_not_there_is_told(truth, given, said, capsys):
    with pytest.raises(SystemExit) as stopped:
        truth.main(given)
    assert stopped.value.code == 2
    assert re.search(said, capsys.readouterr().err)


def test_missing_folders_are_skipped_with_a_reason(truth, tmp_path):
    found, skipped = truth.cases(tmp_path, None, None, None, None)
    assert [case.name for case in found] == ["example", "example_drag"]
    assert skipped[0] == f"phantom: no {tmp_path}/phantom/surface.nc"
    assert skipped[-2:] == ["tissue: give --tissue", "patients: give --patients"]

"""Coverage over draws: `uncertainty_coverage.py`, without the finite elements."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import ttus_opt as tt
from benchmarks import uncertainty_coverage as script
from ttus_opt import example
from ttus_opt.experiment.fits import PatientFits
from ttus_opt.experiment.patients import RECORDINGS, Examination, patients
from ttus_opt.fitting.uncertainty.wrench_uncertainty import WrenchUncertainty

FIGURES = {
    "force_coverage": 0.9,
    "torque_coverage": 0.8,
    "force_std": 0.5,
    "torque_std": 0.004,
    "force_error": 0.25,
    "torque_error": 0.003,
    "force_ranks": 0.5,
    "torque_ranks": 0.25,
    "force_alone": 0.7,
    "torque_alone": 0.6,
}


@pytest.fixture(scope="module")
def examination():
    """The bundled recordings without noise of poses, as if of a patient."""
    surface = tt.Surface.load(example.path("surface.nc"))
    true = {n: tt.read_trajectory(example.path(f"{n}.csv")) for n in RECORDINGS}
    return Examination(patients()[0], surface, {}, true, {})


def rows(patient, draw, *coverage):
    """A row for each coverage, all of one draw."""
    names = RECORDINGS
    return [
        script.Row(patient, name, draw, **{**FIGURES, "force_coverage": share})
        for name, share in zip(names, coverage, strict=False)
    ]


def test_recordings_of_a_draw_are_not_taken_for_independent():
    made = [
        *rows("lean", 0, 0.8, 0.8),
        *rows("lean", 1, 1.0, 1.0),
        *rows("stout", 0, 0.9, 1.0),
        *rows("stout", 1, 0.9, 1.0),
    ]
    mean, error = script.pooled(made, "force_coverage")
    assert mean == pytest.approx(0.925)
    # means over draws: lean 0.9 ± 0.1, stout 0.95 ± 0
    assert error == pytest.approx(0.05)
    assert np.isnan(script.pooled(made[:2], "force_coverage")[1])


def test_table_has_mean_lowest_and_highest_draw():
    made = [*rows("lean", 0, 0.8, 0.9), *rows("lean", 1, 1.0, 0.9)]
    _, _, press, sweep, pooled, *last = script.table(made).splitlines()
    assert press.startswith("| lean, press_fit | 90 (80–100) % | 80 (80–80) % |")
    assert "| 0.50, 0.25 | 4.0, 3.0 | 0.50, 0.25 |" in press
    assert sweep.startswith("| lean, sweep_fit | 90 (90–90) % |")
    assert pooled.startswith("| all | 90 (80–100) % |")
    assert last[0] == "force_coverage: 90.0 ± 5.0 %"
    *_, first = script.table(made[:2]).split("force_coverage: ")
    assert first.startswith("85.0 %")  # of one draw no error is known


def test_a_depth_map_has_no_figures_of_torque():
    unknown = dict.fromkeys(("torque_coverage", "torque_std", "torque_alone"), np.nan)
    made = [replace(row, **unknown) for row in rows("lean", 0, 0.8)]
    told = script.table(made)
    assert "| 80 (80–80) % | – | 0.50, 0.25 | –, 3.0 | 0.50, 0.25 |" in told
    assert "torque_coverage" not in told and "force_coverage" in told


def test_draws_differ_in_all_noise_and_repeat(examination):
    first, again = (script.redrawn(examination, 0).measured for _ in range(2))
    other = script.redrawn(examination, 1).measured
    someone = replace(examination, patient=patients()[1])
    theirs = script.redrawn(someone, 0).measured
    noises = []
    for name, true in examination.true.items():
        np.testing.assert_array_equal(first[name].force, again[name].force)
        noises += [
            (drawn[name].force - true.force)[:20, 0] for drawn in (first, other, theirs)
        ]
        noise = first[name].force - true.force
        assert noise.std() == pytest.approx(0.08, rel=0.1)
        assert 2e-4 < (first[name].position - true.position).std() < 8e-4
    assert np.linalg.matrix_rank(np.array(noises)) == len(noises)


def test_true_errors_against_the_fields_part_alone():
    true = tt.read_trajectory(example.path("press_test.csv"))
    frames = len(true)
    sizes = np.array([0.3, 0.4, 0.5, 0.002, 0.003, 0.004])
    covariance = np.tile(np.diag(sizes**2), (frames, 1, 1))
    stated = SimpleNamespace(
        std=lambda _: WrenchUncertainty(covariance, 100 * covariance)
    )
    off = np.array([[0.5, 0.8, 0.5], [0.0039, 0.0058, 0.0079]])
    errors = SimpleNamespace(
        time=true.time,
        measured_force=true.force,
        measured_torque=true.torque,
        rendered_force=true.force - off[0],
        rendered_torque=true.torque + off[1],
    )
    found = script.against_truth(stated, errors, true)
    # 1.96 · (0.3, 0.4, 0.5) and · (2, 3, 4) m: one force and one torque are outside
    assert found["force_alone"] == pytest.approx(2 / 3)
    assert found["torque_alone"] == pytest.approx(2 / 3)
    assert found["force_error"] == pytest.approx(np.linalg.norm(off[0]))
    assert found["torque_error"] == pytest.approx(np.linalg.norm(off[1]))


@pytest.mark.slow
def test_finished_draws_are_not_computed_again(tmp_path, monkeypatch):
    computed = []

    def judged(fits, setting, draw):
        computed.append((setting.name, draw))
        return rows("lean", draw, 0.9, 0.8)

    space = script.Repetition.rows.__globals__
    monkeypatch.setitem(space, "judged", judged)
    monkeypatch.setitem(space, "examine", lambda *_: None)
    monkeypatch.setitem(space, "redrawn", lambda *_: None)
    setting = script.setting_of("coulomb_global", "contact-size", "given")
    keep = tmp_path / "draws.jsonl"
    asked = script.Repetition(tmp_path, setting, (16, 48, 24), 3.5, keep)
    made = list(asked.rows(patients()[0], range(2)))
    assert list(asked.rows(patients()[0], range(3)))[:4] == made
    auto = script.setting_of("coulomb_global", "contact-size", "auto")
    assert list(replace(asked, setting=auto).rows(patients()[0], range(1)))
    expected = [("coulomb_global", 0), ("coulomb_global", 1), ("coulomb_global", 2)]
    assert computed == [*expected, ("coulomb_global_auto", 0)]


@pytest.mark.slow
def test_uncertainty_of_a_redrawn_fit(examination, tmp_path):
    setting = script.setting_of("eq10", "trilinear", "given")
    fits = PatientFits(script.redrawn(examination, 0), tmp_path, (16, 48, 24), "")
    press, sweep = script.judged(fits, setting, 0)
    assert (press.recording, sweep.recording) == ("press_test", "sweep_test")
    for row in (press, sweep):
        assert 0.8 < row.force_coverage <= 1.0
        assert 0.8 < row.torque_coverage <= 1.0
        assert 0.05 < row.force_error < 1.0
        assert 0.05 < row.force_std < 1.0
        # sensor noise and poses are not part of this
        assert 0.5 < row.force_alone <= 1.0

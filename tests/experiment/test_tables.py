"""Tables of hand-made rows."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from ttus_opt.experiment import tables
from ttus_opt.experiment.boundary import BoundaryError
from ttus_opt.experiment.fits import Row
from ttus_opt.experiment.report import best_setting
from ttus_opt.probe.trajectory import Trajectory
from ttus_opt.report.metrics import Errors
from ttus_opt.report.tables import FORCE


def row(patient, recording, setting, error, told=0.5, against="true"):
    seen = recording.endswith("fit")
    score = Errors(
        error, error, error, 10 * error, error / 100, error, 20.0, 100, 100, 100, 0.5,
        0.01, told, error, error / 5, 2 * error, 9.0, 0.2, 5.0,
    )  # fmt: skip
    return Row(patient, recording, seen, setting, against, score)


def result(rows, boundary=()):
    patients = [SimpleNamespace(rivals=())]
    return SimpleNamespace(rows=rows, boundary=boundary, patients=patients)


def test_paper_tables_have_means_and_the_papers_averages_beside_them():
    rows = [
        row(patient, recording, setting, error, against="measured")
        for patient in ("lean", "stout")
        for recording in ("press_fit", "press_test")
        for setting, error in (
            ("paper_without", 4.0 if patient == "lean" else 2.0),
            ("paper_with", 1.0),
            ("laplace_scaled", 0.5),
            ("eq10", 0.2),
        )
    ]
    found = tables.paper_tables(result(rows), "eq10")
    assert len(found) == 4
    table = found["Magnitude error [N], new trajectory"]
    assert [cells[0] for cells in table.rows[:2]] == ["lean, press", "stout, press"]
    assert table.rows[2][1:] == ["**3.00**", "**1.00**", "**0.50**", "**0.20**"]
    assert table.rows[3][1:3] == ["9.45", "4.04"]
    assert found["Angle [°], same trajectory"].rows[3][2] == "−38 %, −9.37°"
    assert all(len(cells) == len(table.header) for cells in table.rows)


def test_winner_is_bold_per_recording_and_best_is_the_least_told_apart():
    rows = [
        row("lean", "press_test", "eq10", 0.3, told=0.4),
        row("lean", "press_test", "depth_map", 0.2, told=0.6),
        row("lean", "sweep_test", "eq10", 0.1, told=0.1),
        row("lean", "sweep_test", "depth_map", 0.4, told=0.2),
        row("lean", "sweep_test", "laplace_scaled", 0.4, told=0.0),
        row("lean", "sweep_fit", "depth_map", 0.0, told=0.0),
    ]
    found = tables.winners_table(result(rows), FORCE)
    assert found.rows[0][1:] == ["0.30", "**0.20**", "–"]
    assert found.rows[1][1:] == ["**0.10**", "0.40", "0.40"]
    assert best_setting(result(rows)) == "eq10"


def test_boundary_table_tells_the_spread():
    rows = [
        BoundaryError("lean", factor, 10 * factor, before, after)
        for factor, before, after in (
            (0.5, 3.0, 0.3),
            (1.0, 1.0, 0.2),
            (2.0, 4.0, 0.25),
        )
    ]
    before, after = tables.boundary_table(result((), rows)).rows
    assert before[-1] == "**3.00**" and after[-1] == "**0.10**"


def test_aims_met_are_counted_recording_by_recording():
    rows = [
        row("lean", "press_test", "eq10", 0.3),
        row("lean", "sweep_test", "eq10", 3.0),
    ]
    table = tables.comparison_table(result(rows), "true")
    assert table.rows[0][-2:] == ["1, 1, 0, 0", "0/2"]
    assert float(table.rows[0][1]) == pytest.approx(1.65)


def test_missed_aims_are_named_recording_by_recording():
    rows = [
        row("lean", "press_test", "eq10", 0.3),
        row("lean", "sweep_test", "eq10", 3.0),
        row("lean", "sweep_test", "paper_with", 0.1),
    ]
    table = tables.aims_table(result(rows))
    assert table.header == ["", "lean, press", "lean, sweep"]
    assert table.rows[0] == ["eq. 10", "torque, torque angle", "all"]
    assert table.rows[1][1:] == ["–", "torque, torque angle"]
    good = replace(rows[0], score=replace(rows[0].score, torque_share=0.1))
    good = replace(good, score=replace(good.score, torque_angle_error_deg=10.0))
    assert tables.aims_table(result([good])).rows[0][1] == "✓"


def test_chosen_weights_are_told_with_the_reason_where_there_are_none():
    weights = {"force": 0.0952, "torque": 0.1705}
    found = {"by": "marginal likelihood", "reason": "", "weights": weights}
    own = {"by": "formulation", "reason": "one press", "weights": {"force": 0.01}}
    fits = {
        "eq10": SimpleNamespace(facts={}),
        "eq10_auto": SimpleNamespace(
            facts={"formulation": "eq10", "weights_chosen": found}
        ),
        "by_default": SimpleNamespace(
            facts={"formulation": "depth_map", "weights_chosen": own}
        ),
    }
    who = SimpleNamespace(patient=SimpleNamespace(name="lean"), fits=fits)
    first, second = tables.weights_table(SimpleNamespace(patients=[who])).rows
    assert first[1:] == ["eq10", "force 0.095, torque 0.17", "marginal likelihood"]
    assert second == ["lean, default", "depth_map", "force 0.01", "one press"]
    who.fits = {"eq10": fits["eq10"]}
    assert not tables.weights_table(SimpleNamespace(patients=[who]))


def test_rivals_have_no_table_where_none_was_asked_for():
    assert not tables.rivals_table(result([]), "eq10")


def test_rivals_stand_in_a_table_of_their_own_with_those_that_failed():
    rows = [
        row("lean", "press_test", "eq10", 0.3),
        row("lean", "press_test", "comparator eq10", 0.4, told=0.0),
        row("stout", "press_test", "eq10", 0.5),
    ]
    whole = result(rows)
    facts = {"ms_per_frame": 0.5, "ripple": 0.002}
    rivals = (
        SimpleNamespace(name="eq10", facts=facts),
        SimpleNamespace(name="proxy", facts={"failure": "no contact"}),
    )
    whole.patients[:] = [
        SimpleNamespace(rivals=rivals, patient=SimpleNamespace(name="lean")),
        SimpleNamespace(rivals=(), patient=SimpleNamespace(name="stout")),
    ]
    table = tables.rivals_table(whole, "eq10")
    assert table.rows[0][:3] == ["(eq. 10)", "0.30", "3.0"]  # lean alone
    assert table.rows[1][:3] == ["eq10", "0.40", "4.0"]
    assert table.rows[1][-2:] == ["0.5", "0.2"]
    assert table.rows[2][1] == "not fitted: no contact"
    assert all(len(cells) == len(table.header) for cells in table.rows)
    assert [cells[0] for cells in tables.comparison_table(whole, "true").rows] == [
        "eq. 10"
    ]
    assert best_setting(whole) == "eq10"


def test_recordings_are_told_in_newtons_and_millinewton_metres():
    """Ten frames at rest, seven of them pressed with 4 N and 25 mN m."""
    pressed = np.arange(10) >= 3
    force, torque = np.zeros((10, 3)), np.zeros((10, 3))
    force[pressed, 0], torque[pressed, 1] = 4.0, 0.025
    own = Trajectory(
        0.1 * np.arange(10.0),
        np.tile([0.0, 0.14, 0.1], (10, 1)),
        np.tile(np.eye(3), (10, 1, 1)),
        force,
        torque,
    )
    examined = SimpleNamespace(measured={"press_fit": own})
    lean = SimpleNamespace(patient=SimpleNamespace(name="lean"), examination=examined)
    found = tables.recordings_table(SimpleNamespace(patients=[lean]))
    (line,) = found.rows
    assert line[:5] == ["lean, press_fit", "7/10", "4.0", "4.0", "25"]

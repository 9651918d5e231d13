"""Every part on a small case: figures complete, comparable and told in a table.

A new part is tested here by existing, when it is given a quick question below.
"""

from __future__ import annotations

import json
import math
import pstats
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from tests.benchmark.tiny import TINY as TINIER
from ttus_opt.benchmark.parts import recursion
from ttus_opt.benchmark.parts.base import Part
from ttus_opt.benchmark.parts.registry import SOLVERS, chosen, parts
from ttus_opt.benchmark.progress import KEPT, Progress
from ttus_opt.benchmark.row import MEASURED, Row, RunSpec
from ttus_opt.benchmark.settings import Settings
from ttus_opt.errors import InputError

TINY = replace(TINIER, n_poses=24, n_points=1500)
SETTINGS = Settings(solvers=["structured"], closed_form="", time_limit=60.0)

#: Options with which a part is quick
QUICK: dict[str, dict[str, Any]] = {
    "assembly": {"repeats": 1},
    "recursion": {"updates": 30, "compared": 20},
    "rendering": {"passes": 2},
    "ripple": {"voxel": 0.004, "n_points": 600, "n_poses": 20},
}

every_part = pytest.mark.parametrize("part", parts().values(), ids=lambda p: p.name)


def measured(part: Part, folder: Path) -> list[Row]:
    spec = part.plan([TINY], SETTINGS)[0]
    spec = replace(spec, options={**spec.options, **QUICK.get(part.name, {})})
    rows = part.measure(spec, Progress(folder))
    return [part.row(spec, MEASURED, "") | row for row in rows]


@pytest.mark.slow
@every_part
def test_figures_are_complete_and_told(part: Part, tmp_path: Path) -> None:
    rows = part.finished(measured(part, tmp_path), SETTINGS, tmp_path)
    json.dumps(rows)
    if part.name != SOLVERS:  # whose tables are of their own
        for row in rows:
            missing = [c.key for c in part.columns if c.key not in row]
            assert missing in ([], ["sampling"])  # L and b have no sampling
            ratios = [v for k, v in row.items() if k.startswith("ratio_")]
            assert all(v > 0.0 and math.isfinite(v) for v in ratios)
    assert len(part.table(rows).splitlines()) == 2 + len(rows)
    assert (tmp_path / "stages.jsonl").read_text()


@every_part
def test_plan_survives_json(part: Part) -> None:
    plan = part.plan([TINY], SETTINGS)
    told = [json.loads(json.dumps(spec.as_dict())) for spec in plan]
    again = [RunSpec.from_dict(each) for each in told]
    assert [spec.key for spec in again] == [spec.key for spec in plan]
    assert len({spec.key for spec in plan}) == len(plan)
    if plan[0].case is not None:
        other = part.plan([replace(TINY, r_inner=0.04)], SETTINGS)
        assert {s.key for s in other}.isdisjoint(s.key for s in plan)


def test_names() -> None:
    named = ["assembly", "profile", "recursion", "rendering", "ripple"]
    assert chosen("all") == [SOLVERS, *named]
    assert chosen("ripple, solvers,ripple") == ["ripple", SOLVERS]
    for text in ("riple", "", "solvers,all"):
        with pytest.raises(InputError, match="choose from solvers, assembly"):
            chosen(text)


@pytest.mark.slow
def test_a_profile_has_the_fit_and_its_kernels(tmp_path: Path) -> None:
    part = parts()["profile"]
    rows = measured(part, tmp_path)
    assert rows[0]["function"] == "benchmark.parts.profile._fit"
    assert rows[0]["ratio_to_fit"] == 1.0
    assert all(0.0 <= row["own"] <= row["total"] for row in rows)
    by = {row["function"]: row for row in rows}
    assert by["fitting.batch.Fitter.solve"]["calls"] == 1
    saved = pstats.Stats(str(tmp_path / KEPT / "profile-tiny.prof"))
    names = {name for _, _, name in saved.stats}  # type: ignore[attr-defined]
    # compiled kernels are told as well
    assert {"_fit", "solve", "v_cycle", "contact_rows"} <= names
    rows.append({"case": "gone", "status": "refused", "detail": "no file"})
    text = "\n".join(part.below(rows))
    assert "GB/s" in text
    assert "profile-tiny.prof" in text
    assert "gone" not in text


@pytest.mark.slow
def test_recursion_equals_the_batch_fit(tmp_path: Path) -> None:
    (row,) = measured(parts()["recursion"], tmp_path)
    assert row["held"] == 30
    assert row["difference_from_batch"] < 1e-8
    assert row["difference_from_batch"] < 1e-4 * row["change_from_prior"]


@pytest.mark.slow
def test_recursion_takes_poses_again_until_there_are_enough() -> None:
    scene = replace(TINY, n_poses=40).build()
    own = int((scene.rows.contact_points > 0).sum())
    assert own < 100
    found = recursion._touching(scene, 100)
    assert len(found) == 100
    rows = recursion.with_measurements(scene, found).rows
    assert (rows.contact_points > 0).all()


@pytest.mark.slow
def test_recursion_out_of_time_says_how_far_it_came(tmp_path: Path) -> None:
    part = parts()["recursion"]
    (spec,) = part.plan([TINY], Settings(time_limit=1e-9))
    asked = replace(spec, options=QUICK["recursion"])
    (row,) = part.measure(asked, Progress(tmp_path))
    assert row["held"] == 1
    assert row["detail"] == "stopped after 1 of 30 updates by the time limit"
    whole = {"case": "tiny", "status": MEASURED} | row
    assert "stopped after 1 of 30" in part.table([whole])

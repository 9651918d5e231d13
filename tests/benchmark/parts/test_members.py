"""Every part on a small case: figures complete, comparable and told in a table.

A new part is tested here by existing, when it is given a quick question below.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ttus_opt.benchmark import spans
from ttus_opt.benchmark.cases import reference_cases
from ttus_opt.benchmark.parts import recursion
from ttus_opt.benchmark.parts.base import MEASURED, Figures, Part, PartSpec
from ttus_opt.benchmark.parts.registry import parts
from ttus_opt.benchmark.stages import Stages

TINY = replace(reference_cases("S")[0], name="tiny", shape=(9, 20, 9), n_poses=24)

#: Options with which a part is quick
QUICK: dict[str, dict[str, Any]] = {
    "assembly": {"repeats": 1},
    "profile": {"largest_copy": 2**22},
    "recursion": {"updates": 30, "compared": 20},
    "rendering": {"passes": 2},
    "ripple": {"voxel": 0.004, "n_points": 600, "n_poses": 20},
}

every_part = pytest.mark.parametrize("part", parts().values(), ids=lambda p: p.name)


def measured(part: Part, folder: Path) -> list[Figures]:
    spec = part.plan([TINY], 60.0)[0]
    same = {"case": "tiny", "status": MEASURED, "detail": ""}
    begin = Stages(folder / "stages.jsonl")
    rows = part.measure(replace(spec, options=QUICK[part.name]), begin)
    return [same | row for row in rows]


@pytest.mark.slow
@every_part
def test_figures_are_complete_and_told(part: Part, tmp_path: Path) -> None:
    rows = measured(part, tmp_path)
    json.dumps(rows)
    for row in rows:
        missing = [c.key for c in part.columns if c.key not in row]
        assert missing in ([], ["sampling"])  # L and b have no sampling
        ratios = {k: v for k, v in row.items() if k.startswith("ratio_")}
        assert ratios
        assert all(v > 0.0 and math.isfinite(v) for v in ratios.values())
    lines = part.table(rows).splitlines()
    assert len(lines) == 2 + len(rows)
    assert (tmp_path / "stages.jsonl").read_text()


@every_part
def test_plan_survives_json(part: Part) -> None:
    plan = part.plan([TINY], 60.0)
    told = [json.loads(json.dumps(spec.as_dict())) for spec in plan]
    again = [PartSpec.from_dict(each) for each in told]
    assert [spec.key for spec in again] == [spec.key for spec in plan]
    assert len({spec.key for spec in plan}) == len(plan)
    if plan[0].case is not None:
        other = part.plan([replace(TINY, r_inner=0.04)], 60.0)
        assert {s.key for s in other}.isdisjoint(s.key for s in plan)


@pytest.mark.slow
def test_assembly_and_rendering_do_the_same_as_their_references(
    tmp_path: Path,
) -> None:
    for name in ("assembly", "rendering"):
        for row in measured(parts()[name], tmp_path):
            assert row["largest_difference"] < 1e-11, row


@pytest.fixture(scope="module")
def profile(tmp_path_factory: pytest.TempPathFactory) -> list[Figures]:
    """Figures of the profile's part."""
    return measured(parts()["profile"], tmp_path_factory.mktemp("profile"))


def test_profile_adds_up_and_has_all_there_is(profile: list[Figures]) -> None:
    rows = profile
    root, *others = rows
    by = {tuple(row["path"]): row for row in rows}
    assert len(by) == len(rows)
    for row in rows:
        path = tuple(row["path"])
        children = [r for p, r in by.items() if p[:-1] == path]
        inside = sum(r["total"] for r in children)
        assert row["total"] == pytest.approx(row["own"] + inside, rel=1e-9)
        assert row["own"] >= 0.0
    assert sum(row["own_share"] for row in rows) == pytest.approx(1.0)
    assert root["ratio_to_fit"] == 1.0
    assert {row["path"][-1] for row in others} == {
        value
        for key, value in vars(spans).items()
        if key.isupper() and value != spans.FIT
    }
    # two solves with A per product, for the field too, and one for p₀
    calls = dict.fromkeys((spans.SOLVE, spans.EXACT, spans.RESPONSE, spans.ROUGH), 0)
    for row in others:
        if row["path"][-1] in calls:
            calls[row["path"][-1]] += row["calls"]
    products = calls[spans.EXACT] + calls[spans.RESPONSE]
    # and one for the bound on the gap, in the solver and in the verdict
    assert calls[spans.SOLVE] == 2 * products + 1 + 2
    rough = next(
        row for row in rows if tuple(row["path"][-2:]) == (spans.ROUGH, spans.CYCLE)
    )
    assert rough["calls"] == 2 * calls[spans.ROUGH]


def test_profile_is_told_below_its_table(
    profile: list[Figures], tmp_path: Path
) -> None:
    part = parts()["profile"]
    rows = [*profile, {"case": "gone", "status": "refused", "detail": "no file"}]
    text = "\n".join(part.below(rows, tmp_path))
    assert "GB/s" in text
    assert "V-cycle, every array once" in text
    assert "gone" not in text
    assert (tmp_path / "profile-tiny.png").stat().st_size > 5_000


def test_recursion_equals_the_batch_fit(tmp_path: Path) -> None:
    (row,) = measured(parts()["recursion"], tmp_path)
    assert row["held"] == 30
    assert row["difference_from_batch"] < 1e-8
    assert row["difference_from_batch"] < 1e-4 * row["change_from_prior"]


def test_recursion_takes_poses_again_until_there_are_enough() -> None:
    scene = replace(TINY, n_poses=40).build()
    own = int((scene.rows.contact_points > 0).sum())
    assert own < 100
    found = recursion._touching(scene, 100)
    assert len(found) == 100
    rows = recursion.with_measurements(scene, found).rows
    assert (rows.contact_points > 0).all()


def test_recursion_out_of_time_says_how_far_it_came(tmp_path: Path) -> None:
    part = parts()["recursion"]
    (spec,) = part.plan([TINY], 1e-9)
    asked = replace(spec, options=QUICK["recursion"])
    (row,) = part.measure(asked, Stages(tmp_path / "stages.jsonl"))
    assert row["held"] == 1
    assert row["detail"] == "stopped after 1 of 30 updates by the time limit"
    whole: Mapping[str, object] = {"case": "tiny", "status": MEASURED} | row
    assert "stopped after 1 of 30" in part.table([whole])

"""Every part of the benchmark, and how parts are chosen."""

import json
import math
from dataclasses import asdict, replace

import pytest

from tests.benchmark.parts.quick import SETTINGS, TINY, every_part, measured
from ttus_opt.benchmark.parts.base import SOLVERS, parts
from ttus_opt.benchmark.row import RunSpec


@pytest.mark.slow
@every_part
def test_figures_are_complete_and_told(part, tmp_path):
    rows = part.finished(measured(part, tmp_path), SETTINGS, tmp_path)
    json.dumps(rows)
    if part.name != SOLVERS:  # whose tables are of their own
        for row in rows:
            missing = [c.key for c in part.columns if c.key not in row]
            assert missing in ([], ["sampling"])  # L and b have no sampling
            ratios = [v for k, v in row.items() if k.startswith("ratio_")]
            assert all(v > 0.0 and math.isfinite(v) for v in ratios)
    assert len(str(part.table(rows)).splitlines()) == 2 + len(rows)
    assert (tmp_path / "stages.jsonl").read_text()


@every_part
def test_plan_survives_json(part):
    plan = part.plan([TINY], SETTINGS)
    told = [json.loads(json.dumps(asdict(spec))) for spec in plan]
    again = [RunSpec.from_dict(each) for each in told]
    assert [spec.key for spec in again] == [spec.key for spec in plan]
    assert len({spec.key for spec in plan}) == len(plan)
    if plan[0].case is not None:
        other = part.plan([replace(TINY, r_inner=0.04)], SETTINGS)
        assert {s.key for s in other}.isdisjoint(s.key for s in plan)


def test_names():
    named = ["assembly", "live", "profile", "recursion", "rendering", "ripple"]
    assert list(parts()) == [SOLVERS, *named]

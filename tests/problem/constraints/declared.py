"""A scene for constraints, and what kind of rows one declares."""

from tests.conftest import small_scene
from ttus_opt.problem.constraints.base import Bounds, LinearRows

SCENE = small_scene("trilinear", n_poses=30)


REGION = SCENE.voxmap.region


def linear(rows: object) -> LinearRows:
    assert isinstance(rows, LinearRows)
    return rows


def bounds(rows: object) -> Bounds:
    assert isinstance(rows, Bounds)
    return rows

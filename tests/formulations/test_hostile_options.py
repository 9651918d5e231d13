"""Every numeric option of every formulation refuses what is no number, in one line."""

from __future__ import annotations

import importlib
import inspect

import pytest

from tests.conftest import small_scene
from ttus_opt.errors import InputError
from ttus_opt.problem.formulation import available, load

SCENE = small_scene("trilinear", shape=(6, 10, 6), n_poses=6)

HOSTILE = {
    "nan": float("nan"),
    "inf": float("inf"),
    "minus inf": -float("inf"),
    "word": "heavy",
}


def numeric_options(formulation: str) -> list[str]:
    """Options that take a number, by their annotation."""
    build = importlib.import_module(f"formulations.{formulation}").build
    parameters = inspect.signature(build).parameters.values()
    return [p.name for p in parameters if {"float", "int"} & words(p.annotation)]


def words(annotation: object) -> set[str]:
    """The types an annotation names: ``float | None`` names two."""
    told = annotation.__name__ if isinstance(annotation, type) else str(annotation)
    return {word.strip() for word in told.split("|")}


CASES = [
    pytest.param(
        info.name,
        option,
        value,
        id=f"{info.name}-{option}-{bad}",
    )
    for info in available()
    for option in numeric_options(info.name)
    for bad, value in HOSTILE.items()
]


def test_the_table_is_whole() -> None:
    assert numeric_options("eq10") == ["force_weight", "torque_weight", "torque_length"]
    assert numeric_options("laplace_only") == []
    assert "reference" not in numeric_options("tikhonov")
    told = {
        (info.name, option)
        for info in available()
        for option, default in info.options.items()
        if default is None
        or (isinstance(default, int | float) and not isinstance(default, bool))
    }
    tabled = {
        (info.name, option)
        for info in available()
        for option in numeric_options(info.name)
    }
    assert told == tabled


@pytest.mark.parametrize(("formulation", "option", "value"), CASES)
def test_an_option_that_is_no_number_is_refused(
    formulation: str, option: str, value: object
) -> None:
    with pytest.raises(InputError) as refused:
        load(formulation, SCENE, **{option: value}).compile()
    assert "\n" not in str(refused.value)
    assert str(value) in str(refused.value)

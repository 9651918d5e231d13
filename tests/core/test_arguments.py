"""Arguments that were mixed up are told by name, before anything is computed."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.kit import InputError, dragged_scene, refuses
from ttus_opt.core.arguments import chosen, numbers


def mixed_up():
    """Calls with an argument of another type, by a pattern of what they say."""
    scene = dragged_scene("contact")
    solution = tt.fit(scene, "laplace_only")
    field, shell, told = solution.field, scene.shell, scene.trajectory
    return {
        r"the field must be a PotentialField, got a Solution: pass its \.field": (
            lambda: tt.Renderer(solution, shell)
        ),
        "the field must be a PotentialField, got a PointShell$": (
            lambda: tt.Renderer(shell, field)
        ),
        "the probe must be a PointShell, got a str$": lambda: tt.Renderer(field, "a"),
        r"got a Solution: pass its \.field": (
            lambda: tt.evaluate(solution, shell, told)
        ),
        "the probe must be a PointShell, got a Trajectory": (
            lambda: tt.evaluate(field, told, shell)
        ),
        "the recording must be a Trajectory, got a Scene": (
            lambda: tt.evaluate(field, shell, scene)
        ),
        "the voxmap must be a Voxmap, got a PointShell": (
            lambda: tt.Scene.assemble(shell, scene.voxmap, told)
        ),
        "the probe must be a PointShell, got a Trajectory$": (
            lambda: tt.Scene.assemble(scene.voxmap, told, shell)
        ),
        "the scene must be a Scene, got a Voxmap": lambda: tt.fit(scene.voxmap),
        "trajectory position must be an array of real numbers, got list: Tr": (
            lambda: replace(told, position=told.position.tolist())
        ),
        "trajectory force must be an array .* an array of complex128": (
            lambda: replace(told, force=told.force + 0j)
        ),
        "shell areas must be an array of real numbers, got list": (
            lambda: replace(shell, areas=shell.areas.tolist())
        ),
        "field values must be an array of real numbers, got an array of object": (
            lambda: replace(field, values=field.values.astype(object))
        ),
        r"out must have floats of shape \(6,\), got int64 \(6,\)": (
            lambda: tt.Renderer(field, shell).render_into(
                told.rotation[0], told.position[0], np.zeros(6, dtype=int)
            )
        ),
    }


def test_what_was_mixed_up_is_named():
    for told, call in mixed_up().items():
        refuses(InputError, told, call)


@pytest.mark.parametrize("kind", ["f8", "f4", ">f8", "i4", "u1", "?"])
def test_numbers_of_any_size_are_numbers(kind):
    taken = numbers(np.ones((4, 3), dtype=kind)[::2], "values")
    assert taken.dtype == np.float64
    assert taken.flags.c_contiguous
    assert taken.sum() == 6.0
    assert numbers(taken, "values") is taken


def test_names_that_are_chosen():
    known = ("a", "b", "c")
    assert chosen(["c", "a", "c"], known, "letter") == ("c", "a")
    assert chosen([], known, "letter") == ()
    assert chosen(["c", "all"], known, "letter") == known
    told = "unknown letter 'd': choose from a, b, c, or all$"
    refuses(InputError, told, chosen, ["all", "d"], known, "letter")
    told = "unknown letter 'all': choose from a, b, c$"
    refuses(InputError, told, chosen, ["all"], known, "letter", every="")

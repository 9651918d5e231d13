"""Fields that replace each other: what frames read of them, and which are refused."""

from dataclasses import replace

import numpy as np
import pytest

from tests.haptic.test_renderer import random_field
from tests.kit import InputError, small_scene
from ttus_opt.contact.friction import FRICTION
from ttus_opt.haptic import blend
from ttus_opt.haptic.drag import FRICTION as PLACE_OF_FRICTION
from ttus_opt.haptic.field_swap import (
    RenderedField,
    RenderedFields,
    require_alike,
    swapped,
)
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.scan.surface import Surface
from ttus_opt.voxmap.voxmap import Voxmap


def rubbing(scene, mu):
    """A field of its own with a friction coefficient."""
    return RenderedField.of(replace(random_field(scene), parameters={FRICTION: mu}))


def test_a_field_is_copied_and_names_its_drag(scene):
    plain = random_field(scene)
    read = RenderedField.of(plain)
    assert read.coefficients == rubbing(scene, 0.0).coefficients == ""
    assert rubbing(scene, 0.2).coefficients == FRICTION
    np.testing.assert_array_equal(read.values, plain.values.reshape(-1))
    assert not np.shares_memory(read.values, plain.values)


def test_before_the_first_frame_a_field_is_simply_taken(scene):
    old, field = RenderedField.of(random_field(scene)), random_field(scene)
    new = RenderedField.of(replace(field, parameters={FRICTION: 0.2}))
    data = FrameData.of(scene.voxmap, scene.shell, "trilinear")
    fields = RenderedFields.of(old, old, blend.settled_ledger(0.5))
    after = swapped(fields, new, data, np.zeros((len(scene.shell), 7)))
    assert after.pair.current is after.pair.target is new.values
    assert after.pair.ledger is fields.pair.ledger
    assert (fields.drag, after.drag) == ("", FRICTION)


@pytest.mark.parametrize(
    ("current", "target", "progress", "told"),
    [
        (0.2, 0.3, 0.5, FRICTION),
        (0.2, 0.0, 0.5, FRICTION),  # until the swap is over
        (0.2, 0.0, 1.0, ""),
        (0.0, 0.3, 0.0, FRICTION),
        (0.0, 0.0, 0.5, ""),
    ],
)
def test_drag_is_named_while_there_is_any(scene, current, target, progress, told):
    ledger = blend.settled_ledger(0.5)
    ledger[blend.PROGRESS] = progress
    pair = (rubbing(scene, mu) for mu in (current, target))
    assert RenderedFields.of(*pair, ledger).drag == told


@pytest.mark.parametrize("touches", [False, True])
def test_an_update_amid_a_swap_begins_where_that_one_stands(scene, touches):
    """A quarter of the way from drag to none; in the air μ mixes by the shares."""
    old, target, new = (rubbing(scene, mu) for mu in (0.2, 0.0, 0.0))
    old = old._replace(values=2.0 * old.values)
    new = new._replace(values=-new.values)
    ledger = blend.settled_ledger(0.5)
    ledger[[blend.PROGRESS, blend.SEEN]] = 0.25, 1.0
    pose = int(np.argmax(np.abs(scene.N @ old.values).reshape(-1, 3).max(axis=1)))
    ledger[blend.ROTATION : blend.DIFFERENCE] = scene.trajectory.rotation[pose].reshape(
        -1
    )
    away = 0.0 if touches else 0.5
    ledger[blend.PLACE : blend.ROTATION] = scene.trajectory.position[pose] + away
    data = FrameData.of(scene.voxmap, scene.shell, "trilinear")
    fields = RenderedFields.of(old, target, ledger)
    after = swapped(fields, new, data, np.ones((len(scene.shell), 7)))
    now = after.pair
    np.testing.assert_allclose(now.current, 0.75 * old.values + 0.25 * target.values)
    assert now.target is new.values
    np.testing.assert_array_equal(now.target_drag, new.drag)
    assert (after.current_drag, after.target_drag) == (FRICTION, "")
    assert now.current_drag[PLACE_OF_FRICTION] > 0.1
    if not touches:
        assert now.current_drag[PLACE_OF_FRICTION] == pytest.approx(0.75 * 0.2)
    assert now.ledger[blend.PROGRESS] == 0.0
    opened = blend.opened_ledger(ledger, now.current, now.target, data)
    np.testing.assert_array_equal(now.ledger, opened)
    assert opened[blend.DIFFERENCE : blend.BENT].any() == touches


def test_after_a_swap_the_field_in_force_is_its_target(scene):
    old, target, new = (rubbing(scene, mu) for mu in (0.2, 0.1, 0.0))
    ledger = blend.settled_ledger(0.5)
    ledger[blend.SEEN] = 1.0
    data = FrameData.of(scene.voxmap, scene.shell, "trilinear")
    fields = RenderedFields.of(old, target, ledger)
    now = swapped(fields, new, data, np.ones((len(scene.shell), 7))).pair
    assert now.current is target.values and now.target is new.values
    assert now.current_drag is target.drag


def test_a_field_of_another_sampling_or_grid_is_refused(scene):
    field = random_field(scene)
    other = {"trilinear": "voxel-mean", "voxel-mean": "trilinear"}[scene.sampling]
    with pytest.raises(InputError, match="cannot change the field's sampling"):
        require_alike(field, replace(field, sampling=other))
    finer = small_scene(shape=(9, 20, 11), n_poses=2)
    with pytest.raises(InputError, match="cannot change the field's grid"):
        require_alike(field, replace(random_field(finer), sampling=field.sampling))


def test_a_field_on_another_surface_is_refused(scene):
    field, own = random_field(scene), scene.voxmap
    same = Surface.from_radius(own.surface.radius.copy(), own.surface.z)
    require_alike(
        field, replace(field, voxmap=Voxmap(own.grid, same, own.region, own.boundary))
    )
    moved = Surface.from_radius(own.surface.radius + 1e-6, own.surface.z)
    require_alike(field, random_field(scene))
    other = replace(field, voxmap=Voxmap(own.grid, moved, own.region, own.boundary))
    with pytest.raises(InputError, match="cannot change the field's surface"):
        require_alike(field, other)

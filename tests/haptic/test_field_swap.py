"""Fields that replace each other: what frames read of them, and which are refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.haptic.test_renderer import random_field
from ttus_opt.contact.friction import FRICTION
from ttus_opt.errors import InputError
from ttus_opt.haptic.blend import settled_ledger
from ttus_opt.haptic.field_swap import (
    RenderedField,
    RenderedFields,
    require_alike,
    swapped,
)
from ttus_opt.haptic.kernel_data import FrameData
from ttus_opt.scan.surface import Surface
from ttus_opt.scene import Scene
from ttus_opt.voxmap.voxmap import Voxmap


def test_a_field_is_copied_and_names_its_drag(scene: Scene) -> None:
    plain = random_field(scene)
    read = RenderedField.of(plain)
    assert read.coefficients == ""
    np.testing.assert_array_equal(read.values, plain.values.reshape(-1))
    assert not np.shares_memory(read.values, plain.values)
    assert RenderedField.of(
        replace(plain, parameters={FRICTION: 0.2})
    ).coefficients == (FRICTION)
    assert (
        RenderedField.of(replace(plain, parameters={FRICTION: 0.0})).coefficients == ""
    )


def test_before_the_first_frame_a_field_is_simply_taken(scene: Scene) -> None:
    old, field = RenderedField.of(random_field(scene)), random_field(scene)
    new = RenderedField.of(replace(field, parameters={FRICTION: 0.2}))
    data = FrameData.of(scene.voxmap, scene.shell, trilinear=True)
    fields = RenderedFields.of(old, old, settled_ledger(0.5))
    after = swapped(fields, new, data, np.zeros((len(scene.shell), 7)))
    assert after.pair.current is after.pair.target is new.values
    assert after.pair.ledger is fields.pair.ledger
    assert (fields.drag, after.drag) == ("", FRICTION)


def test_a_field_on_another_surface_is_refused(scene: Scene) -> None:
    field, own = random_field(scene), scene.voxmap
    moved = Surface.from_radius(own.surface.radius + 1e-6, own.surface.z)
    require_alike(field, random_field(scene))
    other = replace(field, voxmap=Voxmap(own.grid, moved, own.region, own.boundary))
    with pytest.raises(InputError, match="must keep the field's surface"):
        require_alike(field, other)

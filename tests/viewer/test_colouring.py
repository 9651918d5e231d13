"""Colours of the skin against single presses and the maps they are taken from."""

from dataclasses import replace

import numpy as np
import pytest

import ttus_opt as tt
from tests.fitting.uncertainty.test_field_uncertainty import (
    KEPT_SHARE,
    fitted,
    three_presses,
)
from tests.kit import InputError, torso
from tests.viewer.conftest import field, probe
from ttus_opt.contact.standing import depth_of, standing
from ttus_opt.probe.held import hold
from ttus_opt.viewer import colouring
from ttus_opt.viewer.skin import SkinMesh

SKIN = SkinMesh.of(torso(), 0.03)


def test_stiffness_is_the_force_of_a_press_there():
    renderer = tt.Renderer(field(), probe())
    found = colouring.stiffness(field(), renderer, probe(), hold(), SKIN)
    assert found.unit == "N"
    assert np.isnan(found.values[SKIN.z == SKIN.z.min()]).all()  # the model ends
    for node in np.flatnonzero(np.isfinite(found.values))[::29]:
        place = SKIN.theta[node : node + 1], SKIN.z[node : node + 1]
        R, x = standing(torso(), probe(), hold(), *place, colouring.LIGHT)
        assert depth_of(torso(), probe(), R, x)[0] == pytest.approx(0.005, abs=1e-6)
        force = np.linalg.norm(renderer.render(R[0], x[0]).force)
        assert force == pytest.approx(found.values[node], abs=1e-5)
    front = np.abs(SKIN.theta - np.pi / 2) < 0.3
    back = np.abs(SKIN.theta - 3 * np.pi / 2) < 0.3
    ratio = np.nanmedian(found.values[front]) / np.nanmedian(found.values[back])
    assert ratio > 2.0
    low, high = found.span
    assert np.nanmin(found.values) <= low < high <= np.nanmax(found.values)


def test_uncertainty_is_that_of_the_map():
    found = colouring.uncertainty(field(), SKIN)
    own = field().uncertainty
    assert found.unit == "%"
    assert found.values[5] == 100.0 * own.at(*SKIN.vertices[5].tolist())
    with pytest.raises(InputError, match="--uncertainty"):
        colouring.uncertainty(replace(field(), uncertainty=None), SKIN)


def test_what_was_seen_and_what_was_filled():
    surface = field().voxmap.surface
    hidden = np.broadcast_to((surface.theta > np.pi)[:, None], surface.radius.shape)
    voxmap = replace(field().voxmap, surface=replace(surface, observed=~hidden))
    found = colouring.seen(replace(field(), voxmap=voxmap), SKIN)
    front = (SKIN.theta > 0.1) & (SKIN.theta < 3.0)
    assert (found.values[front] == 1.0).all()
    assert (found.values[(SKIN.theta > 3.3) & (SKIN.theta < 6.1)] == 0.0).all()
    assert found.classes == ("filled in", "seen by the scan")


@pytest.mark.filterwarnings(KEPT_SHARE)
def test_next_presses_are_those_of_the_fit():
    stated = tt.uncertainty(fitted(), three_presses())
    found, presses = colouring.next_presses(stated, SKIN), tt.next_press(stated)
    np.testing.assert_array_equal(found.marks, presses.points[presses.node])
    known = np.flatnonzero(np.isfinite(found.values))
    assert len(known) > 20
    for node in known[:5]:
        way = np.linalg.norm(presses.points - SKIN.vertices[node], axis=1)
        near = presses.before[np.argsort(way)[:4]]
        assert near.min() <= found.values[node] <= near.max()
        assert found.values[node] == pytest.approx(
            np.average(near, weights=np.sort(way)[:4] ** -2.0)
        )

"""Patients that messages are made of: an uneven torso, a dent in it, a fitted field."""

import functools
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import TtusWarning, small_scene, torso
from ttus_opt.message import encode


def uneven(n_theta=40, n_z=15):
    """A small torso with bumps, part of it unseen, in a turned frame."""
    plain = torso(n_theta, n_z)
    theta, z = plain.theta[:, None], plain.z[None]
    bumps = 0.002 * np.sin(5 * theta + 40 * z)
    observed = np.broadcast_to(np.sin(theta) > -0.3 + z, bumps.shape)
    return tt.Surface(
        plain.theta,
        plain.z,
        plain.radius + bumps,
        np.where(observed, 0.001, 0.02 + z),
        observed.copy(),
        tt.Axis(
            np.array([0.1, -0.2, 1.5]), Rotation.from_rotvec([1, 2, 3]).as_matrix()
        ),
    )


def dented(surface, depth=0.004):
    """Changed over the seam of the angle."""
    radius, observed = surface.radius.copy(), surface.observed.copy()
    radius[-3:, 4:7] -= depth
    radius[:2, 4:7] -= depth
    observed[0, 5] ^= True
    return replace(surface, radius=radius, observed=observed)


@functools.cache
def fitted(sampling="trilinear"):
    field = tt.fit(small_scene(sampling), "eq10").field
    return replace(field, parameters={"boundary_scale": 2.0})


#: Of a field that does not go around [rad]
SECTOR = (0.2, 2.6)


@functools.cache
def over_a_sector():
    full = small_scene("trilinear")
    voxmap = tt.Voxmap.from_surface(
        full.voxmap.surface, shape=(15, 13, 8), r_inner=0.03, sector=SECTOR
    )
    there = voxmap, full.shell, full.trajectory
    with pytest.warns(TtusWarning, match="2 of 12 poses touch .* beyond the grid's"):
        scene = tt.Scene.assemble(*there, inner=1.0, sampling="trilinear")
    return tt.fit(scene).field


@functools.cache
def sent_sector():
    """The surface's message and that of the field over a sector."""
    surface = encode(over_a_sector().voxmap.surface)
    return surface, encode(over_a_sector(), base=surface)


@functools.cache
def sent(sampling="trilinear"):
    """The surface's message and the field's."""
    surface = encode(fitted(sampling).voxmap.surface)
    return surface, encode(fitted(sampling), base=surface)

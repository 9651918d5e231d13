"""How many places of a patient do recordings touch? Elsewhere the prior holds.

And which of them are left out together, to see how well a field predicts others.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist

from ttus_opt.contact.places import places
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arrays import Array, IntArray
from ttus_opt.core.errors import warn
from ttus_opt.gaussian.conditioned import ByCovariance
from ttus_opt.gaussian.matern import matern
from ttus_opt.problem.terms.structure import UncertainMean

#: Contacts within this distance of their centre, along the surface, are one spot [m]
SPOT = 0.005

#: Fewest frames in contact for a spread [–]
LEAST = 20

#: Frames between which distances are taken, at most [–]
MOST_FRAMES = 300

#: Variance of a place's own error over that of the field, so that frames of one place
#: do not count as many [–]
OWN_ERROR = 0.05

#: Number of independent places below which a warning is given [–]
FEW_PLACES = 2.0

#: Presses nearer than this part of the probe's size are at the same place [–]
SAME = 0.25

#: Fewest presses that are places; fewer are long lines, which are divided [–]
LEAST_PRESSES = 4


def contact_spread(scene: Scene) -> float:
    """Largest distance of a contact from the contacts' centre, along the surface [m].

    NaN where fewer than `LEAST` frames are in contact.
    """
    touching = scene.touching
    if touching.sum() < LEAST:
        return float("nan")
    x, y, z = _contacts(scene).T
    middle = np.arctan2(np.median(y), np.median(x))
    turned = np.angle(np.exp(1j * (np.arctan2(y, x) - middle)))
    along = z - np.median(z)
    return float(np.hypot(np.hypot(x, y) * turned, along).max())


def warn_of_one_spot(scene: Scene) -> None:
    """Warn when all contacts are in one spot."""
    spread = contact_spread(scene)
    if spread < SPOT:
        warn(
            f"all frames in contact lie within {1e3 * spread:.1f} mm of one spot: "
            "elsewhere the field is only the prior; record presses at several places"
        )


def independent_places(scene: Scene, length: float) -> float:
    """Number of independent values that a field has at the contacts [–].

    1ᵀ(K + ε)⁻¹1 with K the field's correlation between them: one over the variance of
    the estimate of its mean.

    Args:
        scene: Patient, probe and poses.
        length: Matérn length of the field along the surface [m].
    """
    at = _contacts(scene)
    at = at[:: -(-len(at) // MOST_FRAMES)]
    among = matern(cdist(at, at), length)
    among[np.diag_indices_from(among)] += OWN_ERROR
    return ByCovariance.of(among, np.ones(len(at))).square


def telling_places(scene: Scene, length: float) -> float:
    """Number of independent places that tell the deviation σ of a field as well [–].

    tr (K (K + ε)⁻¹)², with K the field's correlation between the places that were
    touched: half of it is the Fisher information about ln σ. Places whose values are
    alike still tell by how much they differ.

    Args:
        scene: Patient, probe and poses.
        length: Matérn length of the field along the surface [m].
    """
    at, place = _contacts(scene), scene.places[scene.touching]
    every = slice(None, None, -(-len(at) // MOST_FRAMES))
    at, place = at[every], np.unique(place[every], return_inverse=True)[1]
    mean = np.eye(place.max() + 1)[place] / np.bincount(place)
    among = mean.T @ matern(cdist(at, at), length) @ mean
    spread = np.linalg.eigvalsh(among)
    return float(np.sum((spread / (spread + OWN_ERROR)) ** 2))


def told_variance(scene: Scene, mean: UncertainMean) -> float:
    """Variance about the mean that the recordings bear out, over that of the fit [–].

    The logarithms of the deviation found and of that of bodies in general are averaged
    by what is known of each: 2 n of n places (`telling_places`), 1/s² of bodies, with s
    the deviation of its logarithm. Never less than 1. A `TtusWarning` tells when the
    recordings cannot tell how stiffness varies.

    Args:
        scene: What was fitted.
        mean: The mean, and the deviation found from it.
    """
    usual, spread = mean.usual
    told = 2.0 * spread**2 * telling_places(scene, mean.length)
    variance = max((usual / mean.deviation) ** (2.0 / (1.0 + told)), 1.0)
    if independent_places(scene, mean.length) < FEW_PLACES:
        warn(
            "the recordings tell hardly more than one place, not how stiffness varies: "
            f"{100 * np.sqrt(variance) * mean.deviation:.0f} % are stated for that, by "
            "what bodies in general do; press at more places (see ttus-opt next-press)",
            2,
        )
    return float(variance)


def _contacts(scene: Scene) -> Array:
    """The shell's reference point in every frame in contact, shape (k, 3) [m]."""
    poses, touching = scene.trajectory, scene.touching
    at = poses.position + poses.rotation @ np.asarray(scene.shell.reference)
    return np.asarray(at[touching])


def pressed_places(scene: Scene) -> IntArray:
    """Number of every frame's place, shape (T,).

    A place is a press with its repetitions, or a whole line along the skin: predicting
    a press from another one at the same place tells nothing about a new place. Of fewer
    than `LEAST_PRESSES` it is as large as the probe.
    """
    press, position = scene.presses, scene.trajectory.position
    size, out = scene.shell.rms_radius, press.copy()
    numbers = np.unique(press[scene.touching]).tolist()
    if len(numbers) < LEAST_PRESSES:
        return places(press, position, size)
    known: dict[int, Array] = {}
    for number in numbers:
        at_press = position[press == number]
        middle = at_press.mean(axis=0)
        if np.linalg.norm(at_press - middle, axis=1).max() > size:
            continue
        far = {one: float(np.linalg.norm(at - middle)) for one, at in known.items()}
        nearest = min(far, key=far.__getitem__, default=-1)
        if nearest >= 0 and far[nearest] < SAME * size:
            out[press == number] = nearest
        else:
            known[number] = middle
    return out

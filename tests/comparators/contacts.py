"""Contacts at the front of the small torso, and laws to fit to them."""

import math

import numpy as np

from tests.kit import ellipsoid, torso
from ttus_opt.comparators.contact_geometry import Patch
from ttus_opt.comparators.patch_law import RecursiveLeastSquares
from ttus_opt.comparators.patch_model import Contact, Sample

#: For laws that look at depth, rate and place alone, at rest along the surface
NO_PATCH = Patch(0.0, 0.0, np.zeros(6), np.zeros(3), np.zeros(3))
STILL = np.zeros(3)


def contacts(n, rng, rate=1.0):
    """Depths of 2 to 12 mm at the front, approached and left."""
    angles, heights = rng.uniform(0.5, 2.5, n), rng.uniform(0.05, 0.15, n)
    places = [
        [0.1 * math.cos(a), 0.1 * math.sin(a), z]
        for a, z in zip(angles, heights, strict=True)
    ]
    return [
        Contact(float(h), float(v), np.array(s), STILL, NO_PATCH)
        for h, v, s in zip(
            rng.uniform(0.2, 1.2, n), rate * rng.normal(size=n), places, strict=True
        )
    ]


def samples(found, forces):
    return [Sample(c, float(f), STILL) for c, f in zip(found, forces, strict=True)]


def made(kind, **options):
    """A comparator on the small torso."""
    return kind(surface=torso(), shell=ellipsoid(), **options)


def after_one_sample(kind, depth, rate, force):
    """A law's parameters after its very first sample, without forgetting."""
    law = made(kind, forgetting=1.0)
    recursions = [RecursiveLeastSquares.start(*pair, 1.0) for pair in law.first]
    contact = Contact(depth, rate, np.array([0.0, 0.1, 0.1]), STILL, NO_PATCH)
    law._take(recursions, Sample(contact, force, STILL), 1.0)
    return law._parameters(recursions)

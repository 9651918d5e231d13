"""What every law with parameters per patch does."""

import math

import numpy as np
import pytest

from tests.comparators.contacts import NO_PATCH, STILL, contacts, made, samples
from tests.comparators.recordings import facing, fitted
from tests.conftest import torso
from tests.refusals import refuses
from ttus_opt.comparators.base import Comparator
from ttus_opt.comparators.hunt_crossley_log import HuntCrossleyLog
from ttus_opt.comparators.hunt_crossley_two_stage import HuntCrossleyTwoStage
from ttus_opt.comparators.kelvin_voigt import KelvinVoigt
from ttus_opt.comparators.patch_law import PatchLaw
from ttus_opt.comparators.patch_model import Contact
from ttus_opt.core.errors import InputError


def test_each_patch_learns_its_own_stiffness():
    rng = np.random.default_rng(5)
    found = contacts(1500, rng, rate=0.0)
    stiff = np.array([4.0 if c.place[0] > 0.0 else 8.0 for c in found])
    law = made(KelvinVoigt, forgetting=1.0)
    law._fit_law(samples(found, stiff * [c.depth for c in found]))
    for angle, expected in ((0.7, 4.0), (2.3, 8.0)):
        place = np.array([0.1 * math.cos(angle), 0.1 * math.sin(angle), 0.1])
        force = law._normal_force(Contact(1.0, 0.0, place, STILL, NO_PATCH))
        # the prior, the mean over all patches, is worth ten of its samples
        assert force == pytest.approx(expected, rel=0.08)


@pytest.mark.parametrize("kind", [KelvinVoigt, HuntCrossleyLog, HuntCrossleyTwoStage])
def test_a_probe_that_leaves_fast_is_not_pulled(kind):
    rng = np.random.default_rng(6)
    found = contacts(60, rng, rate=0.5)
    forces = np.array([6.0 * c.depth * (1.0 + 0.3 * c.rate) for c in found])
    law = made(kind)
    law._fit_law(samples(found, forces))
    law.fitted = True
    R, at = facing(torso(), 1.3, 0.1, 0.004)
    outward = np.array([at[0], at[1], 0.0]) / np.hypot(at[0], at[1])
    rest, slow, fast = (
        law.render(R, at, np.concatenate([v * outward, np.zeros(3)])).force @ outward
        for v in (0.0, 0.01, 1.0)
    )
    assert rest > slow > 0.0
    assert fast == 0.0


@pytest.mark.parametrize("name", ["kelvin_voigt", "hunt_crossley_log"])
def test_a_faster_approach_pushes_no_less(name):
    law: Comparator = fitted(name)
    assert isinstance(law, PatchLaw)
    place = np.array([0.03, 0.09, 0.1])
    forces = [
        law._normal_force(Contact(0.6, rate, place, STILL, NO_PATCH))
        for rate in (-1.0, 0.0, 1.0)
    ]
    assert forces == sorted(forces)


def test_forgetting_that_makes_no_sense_is_told():
    refuses(InputError, "forgetting must be in", made, KelvinVoigt, forgetting=0.0)

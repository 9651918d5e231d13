"""The default model with one part off or changed, for `truth.py --ablate`.

It is assembled here from the package's parts: drag where it is shown, hyperparameters
by evidence, errors by parts, the likeliest sampling. "as it is" has all of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from unittest import mock

import scipy.sparse as sp

from ttus_opt.contact.scene import Scene
from ttus_opt.core.threads import one_blas_thread
from ttus_opt.fitting.weights.weight_choice import likely_sampling
from ttus_opt.problem.formulation import Formulation, Search
from ttus_opt.problem.terms import depth_profile
from ttus_opt.problem.terms.base import Term
from ttus_opt.problem.terms.depth_map import DepthMapTerm
from ttus_opt.problem.terms.depth_map_estimate import (
    LEAST,
    PRIOR,
    DepthMapEstimate,
    estimate_depth_map,
)
from ttus_opt.problem.terms.drag_estimate import estimate_dragged
from ttus_opt.problem.terms.part_noise import SENSOR, TURN
from ttus_opt.problem.terms.wrench import ForceTerm, TorqueTerm


@dataclass(frozen=True)
class Model:
    """The default, but for what is given.

    Attributes:
        held: Values that are not estimated, as medians in `PRIOR`.
        median: Of the prior of the length along the surface [m]; None for one in
            radii of the probe.
        late_in_fit: Whether a tracker's error counts in the fit, too.
        turn: Error of a force's direction [rad].
        beside: Factor on errors of tangential forces and torques [–].
        torque: Whether torques are fitted.
        sampling: None for the likeliest.
        drag: Whether drag is looked for; None for drag that is taken unasked.
        acts_at: Where drag acts.
        searched: Whether μ is the best of many fits, not the first estimate.
        sloped: Power of a spoke's cosine by which its depths count [–].
        least: Least error of a force at first touch [N].
    """

    held: Mapping[str, float] = field(default_factory=dict)
    median: float | None = None
    late_in_fit: bool = True
    turn: float = TURN
    beside: float = 1.0
    torque: bool = True
    sampling: str | None = None
    drag: bool | None = True
    acts_at: str = "auto"
    searched: bool = True
    sloped: float = depth_profile.SLOPED
    least: float = SENSOR

    def choice(self, scene: Scene) -> tuple[Scene, Formulation]:
        """The likeliest sampling, and what is to be fitted in it."""
        with (
            mock.patch.object(depth_profile, "SLOPED", self.sloped),
            mock.patch.dict(LEAST, {"sensor_noise": self.least}),
        ):
            with one_blas_thread():
                likely, dragged = likely_sampling(scene)
            sampling = self.sampling or likely
            own = scene if scene.sampling == sampling else scene.resampled(sampling)
            formulation = self.built(own, dragged)
            for term in formulation.terms:
                term.rows()  # while the power is set: the term's mean is computed once
        return own, formulation

    def built(self, scene: Scene, dragged: bool) -> Formulation:
        """The formulation in one sampling, with drag where the recordings show it."""
        shown = self.drag is None or (self.drag and dragged)
        guess, _ = estimate_dragged(scene, self.acts_at)
        mu = min(guess.friction_coefficient, 1.0) if shown else 0.0
        rows = sp.csr_array(scene.N - mu * guess.drag.rows.force)
        found = self.estimate(scene, rows)
        fitted = found if self.late_in_fit else replace(found, depth_error=0.0)
        noise = fitted.part_noise(scene, self.turn)
        noise = replace(noise, across=self.beside * noise.across)
        prior, weight = DepthMapTerm.of(scene, found), noise.level**-2

        def given(mu: float) -> Formulation:
            drag = guess.drag.with_coefficient(mu)
            force = ForceTerm(scene, weight, noise=noise, drag=drag)
            torque = TorqueTerm(scene, weight, noise=noise, drag=drag)
            terms: list[Term] = [prior, force, torque]
            return Formulation(terms=terms if self.torque else terms[:2])

        formulation = given(mu)
        if shown and self.searched:
            search = Search("friction_coefficient", 0.0, 1.0, given)
            formulation = formulation.with_search(search)
        return formulation

    def estimate(self, scene: Scene, rows: sp.csr_array) -> DepthMapEstimate:
        """The hyperparameters, some of them held."""
        radius = scene.shell.rms_radius
        held: dict[str, Any] = dict(self.held)
        if "surface_length" in held:
            held["surface_length"] *= radius
        length, width = PRIOR["surface_length"]
        median = length if self.median is None else self.median / radius
        with (
            mock.patch.dict(PRIOR, {"surface_length": (median, width)}),
            one_blas_thread(),
        ):
            return estimate_depth_map(scene, rows, **held)


def held(**values: float) -> Model:
    """The default with some values not estimated."""
    return Model(held=values)


#: By what is changed
MODELS = {
    "as it is": Model(),
    "exponent 1": held(exponent=1.0),
    "exponent 1.3": held(exponent=1.3),
    "depth along the spoke": Model(sloped=0.0),
    "depth along the normal": Model(sloped=1.0),
    "first touch as exact as the sensor": Model(least=0.0),
    "law alone": held(deviation=1e-3),
    "deviation 0.4": held(deviation=0.4),
    "no variation with depth": held(depth_length=0.09),
    "depth length 10 mm": held(depth_length=0.01),
    "surface length about 30 mm": Model(median=0.03),
    "surface length 2.6 radii": held(surface_length=2.6),
    "same length around and along": held(length_ratio=1.0),
    "no relative error": held(relative_noise=0.0),
    "relative error of 3 %": held(relative_noise=0.03),
    "no shared error": held(shared_error=0.0),
    "no depth error": held(depth_error=0.0),
    "depth error not in the fit": Model(late_in_fit=False),
    "only noise by evidence": held(
        **{
            name: median
            for name, (median, _) in PRIOR.items()
            if name != "sensor_noise"
        }
    ),
    "direction exact": Model(turn=0.0),
    "tangential, torque × 10": Model(turn=0.0, beside=10.0),
    "neither tangential nor torque": Model(beside=1e4),
    "no torque": Model(torque=False),
    "trilinear": Model(sampling="trilinear"),
    "contact-size": Model(sampling="contact-size"),
    "no drag": Model(drag=False),
    "drag unasked": Model(drag=None),
    "drag at points": Model(acts_at="points"),
    "drag at contact": Model(acts_at="contact"),
    "drag at reference": Model(acts_at="reference"),
    "first friction": Model(searched=False),
}

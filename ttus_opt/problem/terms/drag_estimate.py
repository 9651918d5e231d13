"""A first estimate of drag from the shape of the Laplace field alone.

With p₁ the Laplace field of boundary value 1, forces s (N − μ F) p₁ and torques are
linear in (s, s μ). Least squares in these two unknowns gives μ, the boundary scale with
drag, and whether drag acts on the contact patch, at the probe's reference point, or at
every point of the probe. On the patch or at the reference point, drag may build up over
a presliding length and then hold a probe at rest: it does where that is likelier than
drag that fades, and where the recordings tell the length from none and from any. Where
only lengths up to one are alike, that one is taken: the softest bristle.

The Laplace field hardly tells drag of every point from that of the patch: what it has
wrong of the forces is larger than what they differ by. Where its likelihoods are within
the threshold at which drag itself is shown, the depth map's decide, of the same normal
forces with each one's drag taken from the rows; where these hardly differ, as of a
sweep alone, it acts at every point. They also decide where the Laplace field has too
few places to show drag, but more than none.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ttus_opt.contact.friction import DEADBAND
from ttus_opt.contact.scene import Scene
from ttus_opt.core.arguments import expect_one_of
from ttus_opt.core.arrays import Array
from ttus_opt.problem.terms.depth_map_estimate import (
    DepthMapEstimate,
    estimate_depth_map,
)
from ttus_opt.problem.terms.distinct_drag import LEAST_DISTINCT, distinct_drag
from ttus_opt.problem.terms.drag import AT_POINTS, GlobalCoulomb
from ttus_opt.problem.terms.rows import replaced

#: Gain above which drag is shown: a χ² of one degree of freedom exceeds it in one of a
#: hundred cases [–]
LEAST_GAIN = 6.6

#: Gain above which the depth map is asked too, which saves its estimates, and by how
#: much its log evidence must grow: of one to ten presses with drag by 9 to 91, where
#: the Laplace field gains 0.5 to 5.9; of 46 sets without drag that gains 0.1 at most,
#: of six pieces of tissue up to 5.0, where the log evidence falls [–]
SUSPECTED, EVIDENT = 0.5, 10.0

#: Log odds of drag at every point, before the evidence [–]: a sweep alone hardly tells
#: it from drag of the whole patch, which presses lack
FAVOURED = 1.5

#: Where drag may act
PLACES = ("points", "contact", "reference")

#: Presliding lengths that are compared [m]
LENGTHS = 1e-4 * 2.0 ** np.arange(8)

#: Relative misfit that is rounding [–]
ROUNDING = 1e-9


@dataclass(frozen=True)
class DragEstimate:
    """Drag estimated from the shape of the Laplace field.

    Attributes:
        friction_coefficient: μ, non-negative [–].
        boundary_scale: Factor on the scene's boundary values [–].
        acts_at: ``contact``, ``reference`` or ``points``.
        misfit: Root mean square of force residuals and, if torques were measured, of
            torque residuals over ℓ [N].
        drag: Drag there, without a coefficient; its rows are known.
        gain: Twice the logarithm of the likelihood ratio with and without drag, with
            one independent residual per component of the force and place [–].
    """

    friction_coefficient: float
    boundary_scale: float
    acts_at: str
    misfit: float
    drag: GlobalCoulomb = field(repr=False, compare=False)
    gain: float = 0.0

    @property
    def is_shown(self) -> bool:
        """Whether the recordings show drag by the Laplace field alone."""
        return self.gain > LEAST_GAIN


def estimate_drag(
    scene: Scene,
    acts_at: str = "auto",
    deadband: float = DEADBAND,
    places: tuple[str, ...] = PLACES,
) -> DragEstimate:
    """Estimate drag by least squares.

    Args:
        scene: A scene with measured wrenches.
        acts_at: ``contact``, ``reference``, ``points``, or "auto" for the best fit.
        deadband: Sliding speed below which drag decreases in proportion [m/s].
        places: The choices of "auto".

    Returns:
        The estimate; μ is 0 without sliding, and with drag that could be an elastic
        force (`ttus_opt.problem.terms.distinct_drag`).

    Raises:
        InputError: ``acts_at`` is neither "auto" nor one of the places.
    """
    return alike_drag(scene, acts_at, deadband, places, alike=0.0)[0]


def alike_drag(
    scene: Scene,
    acts_at: str = "auto",
    deadband: float = DEADBAND,
    places: tuple[str, ...] = PLACES,
    alike: float = LEAST_GAIN,
) -> list[DragEstimate]:
    """The best estimate, and others that are hardly worse.

    Args:
        scene: As of `estimate_drag`.
        acts_at: The same.
        deadband: The same [m/s].
        places: The same.
        alike: By how much less the others gain at most [–].
    """
    expect_one_of(acts_at, ("auto", *sorted(places)), "acts_at")
    places = places if acts_at == "auto" else (acts_at,)
    known = vars(scene).setdefault("drag_estimates", {})  # once per scene
    if (deadband, places) not in known:
        known[deadband, places] = _estimates(scene, deadband, places)
    best, *others = known[deadband, places]
    return [best, *(one for one in others if one.gain > best.gain - alike)]


def estimate_dragged(
    scene: Scene,
    acts_at: str = "auto",
    deadband: float = DEADBAND,
    largest: float = 1.0,
    **options: Any,
) -> tuple[DragEstimate, DepthMapEstimate]:
    """The likeliest drag and the depth map with it.

    Args:
        scene: A scene with measured wrenches.
        acts_at: As of `estimate_drag`.
        deadband: The same [m/s].
        largest: Largest μ [–].
        options: Of `estimate_depth_map`.

    Raises:
        InputError: As of both.
        UnusableForcesError: As of `estimate_depth_map`.
    """
    found = []
    for drag in alike_drag(scene, acts_at, deadband):
        mu = min(drag.friction_coefficient, largest)
        rows = scene.N - mu * drag.drag.rows.force
        found.append((drag, estimate_depth_map(scene, rows, **options)))

    def likely(one: tuple[DragEstimate, DepthMapEstimate]) -> float:
        return one[1].log_evidence + FAVOURED * (one[0].acts_at == AT_POINTS)

    return max(found, key=likely)


def estimate_shown(
    scene: Scene, **options: Any
) -> tuple[DragEstimate | None, DepthMapEstimate]:
    """Drag where the recordings show it, and the depth map with it or without.

    Args:
        scene: A scene with measured wrenches.
        options: Of `estimate_depth_map`.

    Returns:
        None for drag that neither the Laplace field nor the depth map shows.

    Raises:
        UnusableForcesError: As of `estimate_depth_map`.
    """
    first = estimate_drag(scene)
    if first.gain <= SUSPECTED:
        return None, estimate_depth_map(scene, **options)
    dragged = estimate_dragged(scene, **options)
    if first.is_shown:
        return dragged
    free = estimate_depth_map(scene, **options)
    evident = dragged[1].log_evidence > free.log_evidence + EVIDENT
    return dragged if evident else (None, free)


def _estimates(
    scene: Scene, deadband: float, places: tuple[str, ...]
) -> list[DragEstimate]:
    """The best estimate, and the others that no elastic force explains."""
    p = scene.laplace.solve(scene.b)
    measured, pressed = scene.f, scene.N @ p
    scale = 1.0 / scene.torque_length
    if not scene.measures_force_only:
        measured = np.concatenate([measured, scale * scene.tau])
        pressed = np.concatenate([pressed, scale * (scene.W @ p)])
    n_places = len(np.unique(scene.places[scene.touching]))

    def judged(drag: GlobalCoulomb) -> DragEstimate:
        force, torque = drag.per_unit(p)
        dragged = force
        if not scene.measures_force_only:
            dragged = np.concatenate([force, scale * torque])
        columns = np.stack([pressed, -dragged], axis=1)
        (s, s_mu), *_ = np.linalg.lstsq(columns, measured, rcond=None)
        if s > 0.0 > s_mu:  # drag that pushes is none: judged without it
            s, s_mu = _scale(pressed, measured), 0.0
        misfit = _mean_size(measured - columns @ [s, s_mu])
        mu = max(float(s_mu / s), 0.0) if s > 0.0 else 0.0
        pressing = bool(pressed.any())
        free = pressed * (_scale(pressed, measured) if pressing else 0.0)
        without = _mean_size(measured - free)
        gain = 0.0
        if without > misfit:
            least = max(misfit, ROUNDING * without)
            gain = 6.0 * n_places * math.log(without / least)
        return DragEstimate(mu, float(s), drag.acts_at, misfit, drag, gain)

    fading = [judged(GlobalCoulomb(scene, place, deadband)) for place in places]
    held = [
        [judged(one.drag.with_presliding(length)) for length in LENGTHS]
        for one in fading
        if one.acts_at != AT_POINTS
    ]
    estimates = _presliding(fading, held)
    estimates.sort(key=lambda one: one.misfit)
    best = estimates[0]
    if not best.friction_coefficient:
        return [best]
    distinct = [
        one
        for one in estimates
        if one.friction_coefficient
        and distinct_drag(scene, one.drag.rows.force) >= LEAST_DISTINCT
    ]
    if best in distinct:
        return distinct
    s = _scale(pressed, measured)
    misfit = _mean_size(measured - s * pressed)
    return [DragEstimate(0.0, s, best.acts_at, misfit, best.drag)]


def _presliding(
    fading: list[DragEstimate], held: Sequence[list[DragEstimate]]
) -> list[DragEstimate]:
    """The estimates with the likeliest presliding length, or why there is none.

    Args:
        fading: Drag that fades at rest, where it may act.
        held: Drag with each of `LENGTHS`, for every place with a bristle.
    """
    if max(one.gain for one in (*fading, *itertools.chain(*held))) <= LEAST_GAIN:
        return fading  # no drag is shown
    if not held:
        return _told(fading, "drag acts at every point, for which a fit has none")
    lengths = max(held, key=lambda some: max(one.gain for one in some))
    gains = np.array([one.gain for one in lengths])
    faded = max(one.gain for one in fading)
    if gains.max() - faded <= LEAST_GAIN:
        return _told(fading, "drag that fades at rest explains the forces as well")
    alike = np.flatnonzero(gains > gains.max() - LEAST_GAIN)
    first, last = (f"{1e3 * LENGTHS[i]:.2g} mm is as likely" for i in alike[[0, -1]])
    if alike[-1] == len(LENGTHS) - 1:
        return _told(fading, f"any length above {first}")
    if alike[0] == 0:  # sliding under as short a bristle shows drag
        longest = [some[alike[-1]] for some in held]
        shown = longest if faded > LEAST_GAIN else fading
        return _told(shown, f"any length below {last}")
    return [max(some, key=lambda one: one.gain) for some in held]


def _told(estimates: list[DragEstimate], why: str) -> list[DragEstimate]:
    """The estimates with the reason why their presliding length is not known."""
    return [
        replace(one, drag=replaced(one.drag, "sliding", "rows", no_presliding=why))
        for one in estimates
    ]


def _scale(pressed: Array, measured: Array) -> float:
    """Factor on the Laplace field's wrenches without drag."""
    return float(pressed @ measured / (pressed @ pressed))


def _mean_size(rest: Array) -> float:
    """Root mean square of residuals."""
    return float(np.sqrt((rest @ rest) / max(len(rest), 1)))

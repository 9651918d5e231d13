"""A recipe for any probe and body: formulation, sampling and weights from the data.

The contact law differs between bodies: pressure on tissue that is deep relative to the
probe depends on the probe's size, pressure on a thin layer does not, and it grows with
depth at different rates. The candidates are eq. 10, with its most likely or its own
weights, and a depth map, each in trilinear and contact-size sampling, and with drag
where the recordings show it. The one that best predicts every press from all others
(`left_out`) is fitted. See docs/method.md, "Tuning".
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from ttus_opt.fitting.left_out import Check, LeftOut, left_out_of
from ttus_opt.fitting.weight_choice import DRAG, WeightChoice, choose_weights
from ttus_opt.fitting.weight_criteria import presses
from ttus_opt.problem import formulation as shelf
from ttus_opt.scene import BOUNDARY_SCALE, Scene

#: Samplings that are compared
SAMPLINGS = ("trilinear", "contact-size")


def choose_recipe(
    scene: Scene, *, progress: Callable[[str], None] | None = None
) -> WeightChoice:
    """Choose formulation, sampling, weights and boundary scale by presses left out.

    Args:
        scene: Patient, probe and measurements.
        progress: Called with a message for every step.

    Returns:
        The problem to fit; that of `choose_weights` where the recordings determine no
        weights or have fewer than three presses.
    """
    best = better_weights(choose_weights(scene, progress=progress), scene)
    if best.left_out is None:
        return best
    press, checks = presses(scene), best.checks
    left_out = _named(best.left_out, scene)
    for other, own in _others(scene, best.formulation.name, progress):
        check = Check.between(other, left_out, press)
        checks = (*checks, check)
        if not check.made:
            break
        if check.better:
            best, left_out = own, other
    return replace(best, checks=checks)


def _others(
    scene: Scene, name: str, progress: Callable[[str], None] | None
) -> Iterator[tuple[LeftOut, WeightChoice]]:
    """Candidates other than the formulation tuned in the scene's own sampling."""
    begin = progress or (lambda _: None)
    depth_map = "depth_map_coulomb" if name == DRAG else "depth_map"
    for sampling in SAMPLINGS:
        place = scene
        if sampling != scene.sampling:
            place = resampled(scene, sampling)
            choice = choose_weights(place, name, progress=progress)
            choice = better_weights(choice, place)
            if choice.left_out is not None:
                yield _named(choice.left_out, place), choice
        begin(f"{depth_map}, {sampling} sampling")
        declared = shelf.load(depth_map, place)
        yield _named(left_out_of(declared), place), WeightChoice(place, declared)


def better_weights(choice: WeightChoice, scene: Scene) -> WeightChoice:
    """The most likely weights or the formulation's own, by left-out presses.

    `choose_weights` keeps the most likely unless they are worse by a standard error;
    here the smaller error decides, as between formulations.

    Args:
        choice: Result of `choose_weights`.
        scene: The scene it was made for, with its own boundary scale.
    """
    found = choice.tuning
    if found is None or not choice.checks[-1].made or choice.checks[-1].better:
        return choice
    own = shelf.load(found.formulation.name, scene)
    reason, checks = str(choice.checks[-1]), choice.checks
    return WeightChoice(
        scene, own, reason=reason, checks=checks, left_out=found.own_left_out
    )


def resampled(scene: Scene, sampling: str) -> Scene:
    """The scene in another sampling; a fitted boundary scale is fitted again.

    Raises:
        InputError: An unknown sampling.
    """
    fitted = BOUNDARY_SCALE in scene.parameters
    return Scene.assemble(
        scene.voxmap,
        scene.shell,
        scene.trajectory,
        inner="fit" if fitted else scene.inner,
        outer=scene.outer / scene.inner if fitted else scene.outer,
        sampling=sampling,
    )


def _named(left_out: LeftOut, scene: Scene) -> LeftOut:
    return replace(left_out, model=f"{left_out.model} ({scene.sampling})")

"""``ttus-opt tune``: weights, boundary scale and friction by places left out."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ttus_opt.cli.console import Stages, tell
from ttus_opt.cli.recording_options import ProbeOptions, RecordingOptions
from ttus_opt.cli.scene_building import measured
from ttus_opt.cli.scene_options import SceneOptions, further_options
from ttus_opt.core.errors import warn

if TYPE_CHECKING:
    from ttus_opt.fitting.weights.tuning_result import Hyperparameter, Tuning


#: What comparisons are called
CRITERIA = {
    "log_evidence": "the evidence of independent frames",
    "gcv": "generalised cross-validation",
}


def tune(
    surface: Path,
    probe: ProbeOptions,
    recordings: RecordingOptions,
    grid: SceneOptions,
    formulation: list[str] | None = None,
    option: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE")] = None,
) -> None:
    """Choose weights, boundary scale and friction from the recordings.

    Args:
        formulation: A formulation's name, or the path of your own file; of several, the
            one that predicts places left out best is taken. By default eq10 and
            coulomb_global.
        option: A fixed option of the formulations; may be repeated.

    Example:
        ttus-opt tune --surface surface.nc --probe ellipsoid:0.030,0.0125,0.018
        --trajectory press_fit.csv --trajectory sweep_fit.csv
    """
    from ttus_opt.fitting.checks.zero_check import warn_of_zero
    from ttus_opt.fitting.weights.tuning import CANDIDATES
    from ttus_opt.fitting.weights.tuning import tune as tune_scene
    from ttus_opt.fitting.weights.weight_choice import too_little

    options, plan = further_options(option or ()), grid.plan
    candidates = list(formulation or CANDIDATES)
    with Stages(2 + len(candidates)) as begin:
        scene = measured(surface, probe, recordings, plan, begin).scene
        warn_of_zero(scene)
        found = tune_scene(scene, candidates, progress=begin, **options)
    tell(_summary(found), *_lines(found))
    reason = too_little(scene)
    if reason:
        warn(f"ttus-opt fit would not choose these weights: {reason}")


def _summary(found: Tuning) -> dict[str, Any]:
    return {
        "formulation": found.formulation.name,
        "weights": found.weights,
        "inner": found.scene.inner,
        "outer": found.scene.outer,
        "hyperparameters": {h.name: asdict(h) for h in found.hyperparameters},
        "not_determined": found.not_determined,
        "noise_N": found.noise,
        "candidates_left_out_force_error_N": found.candidates,
        "left_out_force_error_N": found.left_out_force_error,
        "held_out": [asdict(found.check)],
        "comparisons": [asdict(one) for one in found.comparisons],
        "tuned_on": found.shape,
        "seconds": found.seconds,
        "fit_options": _fit_options(found),
    }


def _fit_options(found: Tuning) -> str:
    """What ``ttus-opt fit`` takes to use it."""
    words = [f"--formulation {found.formulation.name}"]
    words += [f"--inner {found.scene.inner:.6g} --outer {found.scene.outer:.6g}"]
    words += [f"--{name}-weight {w:.4g}" for name, w in found.weights.items()]
    for h in found.hyperparameters:
        if h.name.startswith("option_"):
            words.append(f"--option {h.name.removeprefix('option_')}={h.value:.4g}")
    return " ".join(words)


def _lines(found: Tuning) -> list[str]:
    shape = " x ".join(map(str, found.shape))
    return [
        f"{found.formulation.name}: {_weights(found.weights)}, tuned on {shape} voxels "
        f"in {found.seconds:.1f} s",
        *(
            f"{name}: {error:.3f} N at places left out"
            for name, error in found.candidates.items()
            if name != found.formulation.name
        ),
        *map(_line, found.hyperparameters),
        f"error of a force component: {found.noise:.3f} N",
        f"forces of places left out: {found.left_out_force_error:.3f} N",
        *(
            f"by {CRITERIA[other.criterion]}: {_weights(other.weights)}, which leaves "
            f"{other.left_out_force_error:.3f} N"
            for other in found.comparisons
        ),
        f"ttus-opt fit {_fit_options(found)}",
    ]


def _weights(weights: Any) -> str:
    return ", ".join(f"{name} weight {w:.3g}" for name, w in weights.items())


def _line(one: Hyperparameter) -> str:
    unsure = "" if one.determined else ", not determined by the recordings"
    return f"{one.name}: {one.value:.3g}{unsure}"

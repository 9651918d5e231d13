"""Settings to compare: how the scene is built, a formulation and its options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any

from ttus_opt import paper
from ttus_opt.contact.scene import ScenePlan
from ttus_opt.core import io
from ttus_opt.core.errors import InputError
from ttus_opt.fitting.weights import weight_choice
from ttus_opt.fitting.weights.weight_choice import has_weights
from ttus_opt.problem.formulation import option_defaults

#: Formulations compared by default
FORMULATIONS = ("eq10", "coulomb_global", "depth_map", "depth_map_coulomb")

#: λ_f = λ_τ of formulations that do not choose their own
WEIGHT = 1.0

#: Values of `Plan.weights`: given weights only, also by marginal likelihood, also the
#: default model
WEIGHTS = (GIVEN, AUTO, DEFAULT) = ("given", weight_choice.AUTO, "default")

#: Suffix of settings whose weights are chosen from the recordings
CHOSEN = "_auto"

#: The plan of most, but for its shape
USUAL = ScenePlan(inner="fit")

#: What settings tell of their plan
SCENE = ("inner", "outer", "sampling", "boundary")

#: Names of other files in a patient's folder
RESERVED = ("boundary", "surface")


@dataclass(frozen=True)
class Setting:
    """One way to fit a field to a patient's recordings.

    Attributes:
        name: Name of files and table rows.
        formulation: Its name, or the path of a user's own file; None for the
            default model.
        options: Options of the formulation.
        plan: Of the scene but for its shape; settings with the same share a scene.
        weights: How weights are chosen, one of `WEIGHTS`.
        refined: Whether it is fitted to refined poses.
    """

    name: str
    formulation: str | None
    options: Mapping[str, Any] = field(default_factory=dict)
    plan: ScenePlan = USUAL
    weights: str = GIVEN
    refined: bool = False

    @property
    def source(self) -> dict[str, str]:
        """Checksum of a user's own file, so that an edit invalidates the cache."""
        file = Path(self.formulation or "")
        return {"sha256": io.sha256(file)} if file.suffix == ".py" else {}

    def as_dict(self) -> dict[str, Any]:
        """For JSON, and the cache's key."""
        scene = {name: getattr(self.plan, name) for name in SCENE}
        own = {"name": self.name, "formulation": self.formulation}
        values: dict[str, Any] = {**own, "options": dict(self.options), **scene}
        if self.refined:  # so that older caches stay valid
            values["refined"] = True
        chosen = self.weights == AUTO
        return values | ({"chooses": self.formulation or DEFAULT} if chosen else {})


#: The paper's: without and with measured forces, its boundary, values and weights
_PAPER = ScenePlan(**paper.SCENE, **paper.VOXMAP)
PAPER_WITHOUT = Setting("paper_without", "laplace_only", plan=_PAPER)
PAPER_WITH = Setting("paper_with", "eq10", paper.WEIGHTS, _PAPER)

#: The Laplace field alone, its boundary values scaled to the measured forces
LAPLACE = Setting("laplace_scaled", "laplace_only")

#: What ``ttus-opt fit`` takes without an option
BY_DEFAULT = Setting("by_default", None, weights=AUTO)

#: The same on poses refined by the forces
REFINED = Setting("by_default_refined", None, weights=AUTO, refined=True)


def without_torque(weight: float) -> Setting:
    """Eq. 10 without its torque term."""
    options = {"force_weight": weight, "torque_weight": 0.0}
    return Setting("eq10_force_only", "eq10", MappingProxyType(options))


def compared(formulations: Sequence[str], weight: float) -> tuple[Setting, ...]:
    """A setting for every formulation.

    Args:
        formulations: Names or paths of users' own files.
        weight: λ_f = λ_τ of those whose weights are numbers by default.

    Raises:
        InputError: An unknown formulation, or one named twice.
    """
    settings = tuple(
        Setting(Path(name).stem, name, _weights(name, weight)) for name in formulations
    )
    names = [each.name for each in settings]
    if len(set(names)) < len(names):
        raise InputError(f"formulations are named twice: {', '.join(names)}")
    return settings


def chosen(formulations: Sequence[str], weights: str) -> tuple[Setting, ...]:
    """Settings whose weights are chosen from the recordings.

    Args:
        formulations: Names or paths of users' own files.
        weights: One of `WEIGHTS`.

    Raises:
        InputError: An unknown formulation.
    """
    if weights == GIVEN:
        return ()
    by_evidence = tuple(
        Setting(f"{Path(name).stem}{CHOSEN}", name, weights=AUTO)
        for name in formulations
        if has_weights(name)
    )
    return (*by_evidence, BY_DEFAULT) if weights == DEFAULT else by_evidence


def distinct(settings: Sequence[Setting]) -> tuple[Setting, ...]:
    """The settings, checked for unique names.

    Raises:
        InputError: A user's file has a name that the folder uses otherwise.
    """
    taken = set(RESERVED)
    for each in settings:
        if each.name in taken:
            raise InputError(
                f"{each.formulation} has the name of another file in the folder, "
                f"{each.name}: rename it"
            )
        taken.add(each.name)
    return tuple(settings)


def _weights(name: str, weight: float) -> Mapping[str, float]:
    """Options for a formulation's weights; none where the data choose them."""
    known = option_defaults(name) or {}
    if known.get("force_weight") is None:
        return MappingProxyType({})
    chosen = {"force_weight", "torque_weight"} & set(known)
    return MappingProxyType(dict.fromkeys(sorted(chosen), weight))

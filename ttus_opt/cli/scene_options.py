"""Options about grid, boundary and formulation, one list for fit and path."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Annotated, Any, Literal, Self

import typer

from ttus_opt.cli.options import voxel_counts
from ttus_opt.core.errors import InputError

if TYPE_CHECKING:
    from ttus_opt.contact.scene import ScenePlan
    from ttus_opt.voxmap.grid import Sector


@dataclass(frozen=True)
class ProblemOptions:
    """What is solved and by what, as typed.

    Attributes:
        formulation: A formulation's name, or the path of your own file. By default fit
            takes a depth map sampled by contact size, with drag where the recordings
            show friction, and eq10 where weights are given.
        solver: A solver's name, the path of your own file, or auto; see ttus-opt
            solvers.
        option: An option of the formulation; may be repeated.
        tolerance: Largest relative KKT residual of a solution.
    """

    formulation: str | None = None
    solver: str = "auto"
    option: Annotated[list[str] | None, typer.Option(metavar="KEY=VALUE")] = None
    tolerance: float = 1e-6

    @property
    def name(self) -> str:
        """The formulation, eq. 10 where none was named."""
        return self.formulation or "eq10"

    @cached_property
    def further(self) -> dict[str, Any]:
        """Options of the formulation by name.

        Raises:
            InputError: A pair that is not KEY=VALUE.
        """
        return further_options(self.option or ())

    def check(self) -> None:
        """Refuse a mistyped solver or tolerance before weights are chosen.

        Raises:
            InputError: There is no such solver, or no such tolerance.
        """
        from ttus_opt.solvers import registry
        from ttus_opt.solvers.base import Request

        Request(self.tolerance)
        if self.solver != "auto":
            registry.asked_for(self.solver)


@dataclass(frozen=True)
class SceneOptions:
    """Grid, boundary, its values and sampling, as typed.

    Attributes:
        shape: Number of voxels in r, θ, z: n_r,n_theta,n_z.
        sector: Restrict the grid to these angles θ [deg], with zero flux through its
            sides, so that an unseen back is left out.
        r_inner: Radius of the innermost layer [m].
        r_outer: Radius of the outermost layer [m]. By default 2 cm beyond the surface.
        inner: Potential on the inner layer, or fit, which scales it to the forces. By
            default fit, where there are forces.
        outer: Negative of the outer layer's potential; with --inner fit, negative of
            its ratio to the inner one.
        sampling: How contact samples the field: trilinear (the default with a
            formulation), voxel-mean, or contact-size:LENGTH (trilinear times 10 mm over
            the length of the contact patch, at least LENGTH in m; the default without
            one, by the recordings).
        boundary: Where p = 0 lies: subvoxel (the default), at the true radius, or
            staircase, on the nearest voxels.
    """

    shape: str = "48,120,60"
    sector: Annotated[str | None, typer.Option(metavar="FROM,TO")] = None
    r_inner: float = 0.03
    r_outer: float | None = None
    inner: str | None = None
    outer: float = 1.0
    sampling: str | None = None
    boundary: str | None = None

    def as_in_the_paper(self) -> Self:
        """With the paper's boundary, its value and sampling where none are given."""
        from ttus_opt.core.paper import SCENE, VOXMAP

        return replace(
            self,
            inner=str(SCENE["inner"]) if self.inner is None else self.inner,
            sampling=self.sampling or SCENE["sampling"],
            boundary=self.boundary or VOXMAP["boundary"],
        )

    @cached_property
    def plan(self) -> ScenePlan:
        """How the scene is built.

        Raises:
            InputError: Invalid counts or sector, or an inner value other than a number.
        """
        from ttus_opt.contact.scene import ScenePlan

        return ScenePlan(
            voxel_counts(self.shape),
            self.r_inner,
            self.r_outer,
            None if self.inner is None else boundary_value(self.inner),
            self.outer,
            self.sampling or ScenePlan.sampling,
            self.boundary or ScenePlan.boundary,
            sector_of(self.sector),
        )


def boundary_value(text: str) -> float | Literal["fit"]:
    """Value of ``--inner``.

    Raises:
        InputError: Neither a number nor fit.
    """
    if text == "fit":
        return "fit"
    try:
        return float(text)
    except ValueError:
        raise InputError(f"--inner takes a number or fit, got {text!r}") from None


def sector_of(text: str | None, option: str = "--sector") -> Sector | None:
    """Value of ``--sector``, or of another option of two angles [rad].

    Raises:
        InputError: It is not two angles, or they leave no part of the turn.
    """
    from ttus_opt.voxmap.grid import checked_sector

    if text is None:
        return None
    try:
        low, high = (math.radians(float(part)) for part in text.split(","))
    except ValueError:
        raise InputError(
            f"{option} takes two angles in degrees, FROM,TO, got {text!r}"
        ) from None
    return checked_sector((low, high))


def further_options(pairs: Sequence[str]) -> dict[str, Any]:
    """Options written key=value; a value is JSON where it can be read as that.

    Raises:
        InputError: A pair that is not KEY=VALUE.
    """
    options: dict[str, Any] = {}
    for pair in pairs:
        key, equals, value = pair.partition("=")
        if not (equals and key.isidentifier()):
            raise InputError(f"--option takes key=value, got {pair!r}")
        try:
            options[key] = json.loads(value)
        except json.JSONDecodeError:
            options[key] = value
    return options

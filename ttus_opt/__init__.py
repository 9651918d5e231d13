"""Convex patient modelling for haptic tele-ultrasound.

Names are loaded when first used: rendering never pays for (or imports) the modelling
packages, a notebook never waits for what it does not touch.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ttus_opt.axis import Axis as Axis
    from ttus_opt.contour import extract_surface as extract_surface
    from ttus_opt.errors import TtusError as TtusError
    from ttus_opt.errors import TtusWarning as TtusWarning
    from ttus_opt.field import PotentialField as PotentialField
    from ttus_opt.fitting import Fitter as Fitter
    from ttus_opt.fitting import fit as fit
    from ttus_opt.haptic_blend import BlendLaw as BlendLaw
    from ttus_opt.metrics import evaluate as evaluate
    from ttus_opt.point_shell import PointShell as PointShell
    from ttus_opt.problem.formulation import Formulation as Formulation
    from ttus_opt.problem.solution import NoSolutionError as NoSolutionError
    from ttus_opt.problem.solution import Solution as Solution
    from ttus_opt.problem.solution import Status as Status
    from ttus_opt.recursion import RecursiveFit as RecursiveFit
    from ttus_opt.renderer import Renderer as Renderer
    from ttus_opt.scan import read_cloud as read_cloud
    from ttus_opt.scene import Scene as Scene
    from ttus_opt.surface import Surface as Surface
    from ttus_opt.trajectory import Trajectory as Trajectory
    from ttus_opt.trajectory import read_trajectory as read_trajectory
    from ttus_opt.voxmap import Voxmap as Voxmap

_HOME = {
    "Axis": "axis",
    "BlendLaw": "haptic_blend",
    "Fitter": "fitting",
    "Formulation": "problem.formulation",
    "NoSolutionError": "problem.solution",
    "PointShell": "point_shell",
    "PotentialField": "field",
    "RecursiveFit": "recursion",
    "Renderer": "renderer",
    "Scene": "scene",
    "Solution": "problem.solution",
    "Status": "problem.solution",
    "Surface": "surface",
    "Trajectory": "trajectory",
    "TtusError": "errors",
    "TtusWarning": "errors",
    "Voxmap": "voxmap",
    "evaluate": "metrics",
    "extract_surface": "contour",
    "fit": "fitting",
    "read_cloud": "scan",
    "read_trajectory": "trajectory",
}

__all__ = list(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    if name not in _HOME:
        raise AttributeError(f"module 'ttus_opt' has no attribute {name!r}")
    value = getattr(importlib.import_module(f"ttus_opt.{_HOME[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted({*globals(), *_HOME})

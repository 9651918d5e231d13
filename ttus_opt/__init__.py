"""Convex patient modelling for haptic tele-ultrasound.

Names are loaded when first used: rendering never pays for (or imports) the modelling
packages, a notebook never waits for what it does not touch.
"""

from __future__ import annotations

TYPE_CHECKING = False  # without the cost of loading typing
if TYPE_CHECKING:
    from typing import Any

    from ttus_opt.contact.scene import Scene as Scene
    from ttus_opt.core import paper as paper
    from ttus_opt.core.errors import TtusError as TtusError
    from ttus_opt.core.errors import TtusWarning as TtusWarning
    from ttus_opt.fitting.batch import Fitter as Fitter
    from ttus_opt.fitting.batch import fit as fit
    from ttus_opt.fitting.path.path_dataset import (
        read_solution_path as read_solution_path,
    )
    from ttus_opt.fitting.path.path_dataset import (
        write_solution_path as write_solution_path,
    )
    from ttus_opt.fitting.path.solution_path import PathRun as PathRun
    from ttus_opt.fitting.path.solution_path import solution_path as solution_path
    from ttus_opt.fitting.poses.pose_refinement import refine_poses as refine_poses
    from ttus_opt.fitting.recursion.recursive import RecursiveFit as RecursiveFit
    from ttus_opt.fitting.uncertainty.field_uncertainty import (
        uncertainty as uncertainty,
    )
    from ttus_opt.fitting.uncertainty.next_press import next_press as next_press
    from ttus_opt.fitting.weights.tuning import tune as tune
    from ttus_opt.haptic.blend import BlendLaw as BlendLaw
    from ttus_opt.haptic.renderer import Renderer as Renderer
    from ttus_opt.probe.point_shell import PointShell as PointShell
    from ttus_opt.probe.tracker_noise import TrackerNoise as TrackerNoise
    from ttus_opt.probe.trajectory import Trajectory as Trajectory
    from ttus_opt.probe.trajectory import read_trajectory as read_trajectory
    from ttus_opt.problem import constraints as constraints
    from ttus_opt.problem import terms as terms
    from ttus_opt.problem.formulation import Formulation as Formulation
    from ttus_opt.problem.formulation import load_formulation as load_formulation
    from ttus_opt.problem.solution import NoSolutionError as NoSolutionError
    from ttus_opt.problem.solution import Solution as Solution
    from ttus_opt.problem.solution import Status as Status
    from ttus_opt.problem.terms.base import AffineRows as AffineRows
    from ttus_opt.problem.terms.base import Term as Term
    from ttus_opt.problem.terms.cvxpy_term import CvxpyTerm as CvxpyTerm
    from ttus_opt.report import plots as plots
    from ttus_opt.report.metrics import evaluate as evaluate
    from ttus_opt.scan.cloud import read_cloud as read_cloud
    from ttus_opt.scan.extraction import extract_surface as extract_surface
    from ttus_opt.scan.frame import Axis as Axis
    from ttus_opt.scan.surface import Surface as Surface
    from ttus_opt.session.pipeline import run_session as run_session
    from ttus_opt.viewer.viewer import view as view
    from ttus_opt.voxmap.field import PotentialField as PotentialField
    from ttus_opt.voxmap.voxmap import Voxmap as Voxmap

_HOME = {
    "AffineRows": "problem.terms.base",
    "Axis": "scan.frame",
    "BlendLaw": "haptic.blend",
    "CvxpyTerm": "problem.terms.cvxpy_term",
    "Fitter": "fitting.batch",
    "Formulation": "problem.formulation",
    "NoSolutionError": "problem.solution",
    "PathRun": "fitting.path.solution_path",
    "PointShell": "probe.point_shell",
    "PotentialField": "voxmap.field",
    "RecursiveFit": "fitting.recursion.recursive",
    "Renderer": "haptic.renderer",
    "Scene": "contact.scene",
    "Solution": "problem.solution",
    "Status": "problem.solution",
    "Surface": "scan.surface",
    "Term": "problem.terms.base",
    "TrackerNoise": "probe.tracker_noise",
    "Trajectory": "probe.trajectory",
    "TtusError": "core.errors",
    "TtusWarning": "core.errors",
    "Voxmap": "voxmap.voxmap",
    "uncertainty": "fitting.uncertainty.field_uncertainty",
    "evaluate": "report.metrics",
    "extract_surface": "scan.extraction",
    "fit": "fitting.batch",
    "load_formulation": "problem.formulation",
    "next_press": "fitting.uncertainty.next_press",
    "read_cloud": "scan.cloud",
    "read_solution_path": "fitting.path.path_dataset",
    "read_trajectory": "probe.trajectory",
    "refine_poses": "fitting.poses.pose_refinement",
    "run_session": "session.pipeline",
    "solution_path": "fitting.path.solution_path",
    "tune": "fitting.weights.tuning",
    "view": "viewer.viewer",
    "write_solution_path": "fitting.path.path_dataset",
}

#: Modules whose content is found by name, such as ``tt.terms.LaplaceTerm``
_SHELVES = {
    "constraints": "problem.constraints",
    "paper": "core.paper",
    "plots": "report.plots",
    "terms": "problem.terms",
}

__all__ = [*_HOME, *_SHELVES]


def __getattr__(name: str) -> Any:
    """Load a public name from its module on first use."""
    import importlib

    value: Any
    if name == "__version__":
        value = _version()
    elif name in _SHELVES:
        value = importlib.import_module(f"ttus_opt.{_SHELVES[name]}")
    elif name in _HOME:
        value = getattr(importlib.import_module(f"ttus_opt.{_HOME[name]}"), name)
    else:
        raise AttributeError(f"module 'ttus_opt' has no attribute {name!r}")
    globals()[name] = value
    return value


def _version() -> str:
    import importlib.metadata

    try:
        return importlib.metadata.version("ttus-opt")
    except importlib.metadata.PackageNotFoundError:  # run from its source
        return "0+unknown"


def __dir__() -> list[str]:
    """Public names, loaded or not."""
    return sorted({*globals(), *__all__})

"""``ttus-opt warm-up``: compile ahead, for machine images and before live sessions.

Machine code depends on the types of the arguments, not on their sizes, so a coarse grid
suffices. `ttus_opt.core.compiled` caches it.
"""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import ttus_opt as tt
from ttus_opt.cli.console import Stages, tell
from ttus_opt.core.interrupts import ended_at_once

#: Grid, probe points and frames of the run, and its stages
SHAPE, POINTS, FRAMES, N_STAGES = (16, 24, 12), 300, slice(20, 60), 6


def warm_up() -> None:
    """Compile everything ahead of its first use.

    Example:
        ttus-opt warm-up
    """
    from ttus_opt.core.cache_folder import cache_folder

    # packages that load take an interrupt for their own
    with ended_at_once(), Stages(N_STAGES) as begin:
        seconds = compile_all(begin)
    folder = cache_folder()
    facts = {"seconds": seconds, "folder": None if folder is None else str(folder)}
    kept = "not kept" if folder is None else f"kept in {folder}"
    tell(facts, f"compiled in {seconds:.0f} s, {kept}")


def compile_all(progress: Callable[[str], object] = lambda stage: None) -> float:
    """Run every compiled function once.

    Args:
        progress: Called with the name of each of the `N_STAGES` stages as it begins.

    Returns:
        Duration; a few seconds if everything had been compiled before [s].
    """
    from ttus_opt import example

    start = time.perf_counter()
    surface = tt.Surface.load(example.path("surface.nc"))
    voxmap = tt.Voxmap.from_surface(surface, shape=SHAPE, r_inner=0.03)
    shell = tt.PointShell.from_spec(example.PROBE, n_points=POINTS)
    sweep = tt.read_trajectory(example.path("sweep_drag_fit.csv")).select(FRAMES)
    progress("probe meshes")
    _read_mesh()
    for sampling in ("voxel-mean", "trilinear"):
        progress(f"rows and frames, {sampling}")
        scene = tt.Scene.assemble(voxmap, shell, sweep, inner=1.0, sampling=sampling)
        _render(scene)
    progress("large grids")
    _share_a_cycle(voxmap)
    progress("limits")
    tt.fit(scene, "eq10_sign_monotone", solver="structured")
    tt.fit(scene, "coulomb_drag", solver="structured")
    progress("updates")
    tt.RecursiveFit(scene).field  # noqa: B018  computed on access
    return time.perf_counter() - start


def _read_mesh() -> None:
    import trimesh

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "sphere.stl"
        trimesh.creation.icosphere(subdivisions=2, radius=0.02).export(file)
        tt.PointShell.from_mesh(file, n_points=POINTS, unit="m")


def _share_a_cycle(voxmap: tt.Voxmap) -> None:
    """A V-cycle as on grids of millions of voxels."""
    from ttus_opt.laplace.multigrid.workspace import Workspace
    from ttus_opt.laplace.system import LaplaceSystem

    levels = LaplaceSystem.assemble(voxmap).multigrid.hierarchy
    Workspace(levels, large=0).v_cycle()


def _render(scene: tt.Scene) -> None:
    """Render frames with drag while new fields arrive."""
    field = tt.fit(scene, "viscous_drag", solver="structured").field
    renderer = tt.Renderer(field, scene.shell)
    motion = scene.trajectory
    for frame in zip(motion.rotation, motion.position, motion.twist(), strict=True):
        renderer.render(*frame)
        renderer.update(field)

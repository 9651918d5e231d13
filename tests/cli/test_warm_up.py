"""After `warm_up` nothing that the main job uses is left to compile."""

import numba.core.event as events
import pytest

import ttus_opt as tt
from ttus_opt import example
from ttus_opt.cli.warm_up import N_STAGES, warm_up
from ttus_opt.laplace.multigrid.workspace import Workspace
from ttus_opt.laplace.system import LaplaceSystem


class _Compiling(events.Listener):
    def __init__(self):
        self.names: list[str] = []

    def on_start(self, event):
        self.names.append(event.data["dispatcher"].py_func.__name__)

    def on_end(self, event):
        pass


@pytest.mark.slow
def test_the_main_job_compiles_nothing_afterwards():
    told: list[str] = []
    warm_up(told.append)
    assert len(told) == N_STAGES
    with events.install_listener("numba:compile", _Compiling()) as heard:
        surface = tt.Surface.load(example.path("surface.nc"))
        voxmap = tt.Voxmap.from_surface(surface, shape=(20, 36, 16), r_inner=0.03)
        shell = tt.PointShell.from_spec(example.PROBE, n_points=400)
        presses = tt.read_trajectory(example.path("press_fit.csv"))
        scene = tt.Scene.assemble(
            voxmap, shell, presses, inner="fit", sampling="trilinear"
        )
        field = tt.fit(scene, "eq10_sign").field
        renderer = tt.Renderer(field, shell)
        renderer.render(presses.rotation[25], presses.position[25])
        tt.evaluate(field, shell, presses)
        levels = LaplaceSystem.assemble(voxmap).multigrid.hierarchy
        Workspace(levels, large=0).v_cycle()
    assert heard.names == []

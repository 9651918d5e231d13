"""After `warm-up` nothing that the main job uses is left to compile."""

from pathlib import Path

import numba.core.event as events
import pytest

import ttus_opt as tt
from ttus_opt import example
from ttus_opt.cli import warm_up_command
from ttus_opt.core import cache_folder
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
    warm_up_command.compile_all(told.append)
    assert len(told) == warm_up_command.N_STAGES
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


@pytest.mark.parametrize("folder", [None, Path("somewhere")])
def test_it_says_where_the_code_is_kept(run, folder, monkeypatch):
    monkeypatch.setattr(warm_up_command, "compile_all", lambda _: 12.0)
    monkeypatch.setattr(cache_folder, "cache_folder", lambda: folder)
    where = "not kept" if folder is None else "kept in somewhere"
    assert run("warm-up").out.strip().endswith(f"compiled in 12 s, {where}")
    told = run("warm-up --json").told
    assert told == {"seconds": 12.0, "folder": folder and "somewhere"}

"""How an empty page looks: its panel and its light, before anybody knows what is shown.

Light that changes later makes a browser build everything anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ttus_opt.viewer.page_script import COARSE, run_on_pages

if TYPE_CHECKING:
    import viser

#: Intensity of the even light; π shows a surface in its own colour
LIGHT = 2.1

#: Width of the panel [px]
WIDTH = 360

#: Where two lights are, from the front, which is up [m]
SIDES = ((0.7, 0.0, -0.5), (-0.7, 0.0, -0.5))


def dress(server: viser.ViserServer) -> list[Any]:
    """The panel on the right, without a share button; even light.

    Returns:
        Two weaker lights, for a front that is +y.
    """
    gui, scene = server.gui, server.scene
    gui.configure_theme(
        show_logo=False, show_share_button=False, control_width="medium",
        brand_color=(11, 79, 156),
    )  # fmt: skip
    gui.main_panel.dock_right()
    gui.main_panel.set_width(WIDTH)
    run_on_pages(server, COARSE)
    scene.world_axes.visible = False
    scene.configure_default_lights(False)
    scene.configure_environment_map(None)
    # mostly even, so that colours are the legend's
    scene.add_light_ambient("/light/even", intensity=LIGHT)
    return [
        scene.add_light_directional(
            f"/light/from{k}", intensity=0.35 * LIGHT, position=(x, 1.0 + y, z)
        )
        for k, (x, y, z) in enumerate(SIDES)
    ]

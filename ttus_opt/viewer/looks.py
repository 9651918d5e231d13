"""How an empty page looks: its panel and its light, before anybody knows what is shown.

Light that changes later makes a browser build everything anew.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ttus_opt.core.arrays import Array

if TYPE_CHECKING:
    import viser
from typing import Any

#: Intensity of the even light; π shows a surface in its own colour
LIGHT = 2.1

#: Intensity of each of two lights, of that
SIDE = 0.35

#: Width of the panel [px]
WIDTH = 360

#: Where they are [m], before a front that is +y
SIDES = ((0.7, 1.0, -0.5), (-0.7, 1.0, -0.5))


def dress(server: viser.ViserServer) -> None:
    """The panel on the right, without a share button; even light and two weaker."""
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
    for k, side in enumerate(SIDES):
        scene.add_light_directional(
            f"/light/from{k}", intensity=SIDE * LIGHT, position=side
        )


def small(html: str) -> str:
    """A paragraph of the panel in small letters."""
    return f'<div style="font-size:12px;padding:2px 12px 8px">{html}</div>'


def lit(colours: NDArray[np.uint8], normals: Array, front: Array) -> Array:
    """Light that a rough surface sends under these lights, turned to its front.

    A page that draws by software would compute it at every pixel of every frame.

    Args:
        colours: sRGB, 0 to 255, shape (n, 3).
        normals: Unit vectors, shape (n, 3) [–].
        front: Direction that is up, shape (3,) [–].

    Returns:
        Linear, 1 for white in full light, shape (n, 3) [–].
    """
    share = colours / 255.0
    linear = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    up, along = np.array([front, [0.0, 0.0, 1.0]])
    towards = np.array(SIDES) @ np.stack([np.cross(up, along), up, along])
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    sides = np.maximum(normals @ towards.T, 0.0).sum(axis=1, keepdims=True)
    return np.asarray(LIGHT / np.pi * (1.0 + SIDE * sides) * linear)


#: While the canvas is dragged, fewer pixels a side until `LEAST` frames a second come,
#: down to a share `FLOOR`; then all again. A visitor's own ``?fixedDpr=`` stays
COARSE = """
(() => {
  const LEAST = 28, FLOOR = 0.5, FEWER = 0.7, EVERY = 300;
  if (window.drawsLess) return;
  window.drawsLess = true;
  let share = 1, timer = 0, frames = 0;
  const settings = () => window.__viserTestpoints?.devSettings;
  const draw = () => settings().set({
    fixedDpr: timer ? share * Math.min(2, window.devicePixelRatio) : null });
  const count = () => { frames++; if (timer) requestAnimationFrame(count); };
  window.addEventListener("pointerdown", (event) => {
    if (timer || event.target !== window.__viserMutable?.canvas) return;
    if (settings()?.get().fixedDpr !== null) return;
    share = Math.min(1, share / FEWER);
    let time = performance.now();
    timer = setInterval(() => {
      const now = performance.now(), rate = 1e3 * frames / (now - time);
      [frames, time] = [0, now];
      if (rate > LEAST || share <= FLOOR) return;
      share = Math.max(FLOOR, FEWER * share);
      draw();
    }, EVERY);
    frames = 0;
    requestAnimationFrame(count);
    if (share < 1) draw();
  }, true);
  for (const end of ["pointerup", "pointercancel", "blur"])
    window.addEventListener(end, () => {
      if (!timer) return;
      clearInterval(timer);
      timer = 0;
      draw();
    }, true);
})();
"""


def run_on_pages(server: Any, source: str) -> None:
    """Run a script on every page, those that come later too."""
    from viser._messages import RunJavascriptMessage

    server._websock_server.queue_message(RunJavascriptMessage(source=source))

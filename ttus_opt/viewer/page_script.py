"""What a page does by itself: fewer pixels while somebody drags on a slow machine."""

from __future__ import annotations

from typing import Any

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

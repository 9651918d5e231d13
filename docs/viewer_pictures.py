"""Draws the pictures of the viewer's page, in a browser; `make picture` calls it.

    python docs/viewer_pictures.py

It shows the bundled example. Where no Chromium is installed, it says so and does
nothing.
"""

from __future__ import annotations

import io
import os
import shutil
import sys
from collections.abc import Callable
from pathlib import Path

from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

import ttus_opt as tt
from ttus_opt.cli.view_command import shown_example
from ttus_opt.viewer.guarded_server import guarded_server
from ttus_opt.viewer.live_page import LivePage
from ttus_opt.viewer.viewer import Viewer

FOLDER = Path(__file__).parent / "pictures"
SIZE, LIVE_SIZE = (1000, 860), (1000, 920)  # [px]

#: Frame of the recording at its hardest press
PRESSED = 276

#: Software draws slowly: a frame is waited for [ms]
PATIENCE, DRAWN = 240_000, 6_000

#: A live session has pressed several times [ms], and presses [N]
LEARNED, PRESSING = 20_000, 4.5


def press(viewer: Viewer, page: Page) -> None:
    """The probe pressed in where the skin is stiff."""
    viewer.state.slide(1.45, 0.17)
    viewer.state.press(0.012)


def section(viewer: Viewer, page: Page) -> None:
    """The patient cut open below the probe."""
    page.get_by_role("tab", name="Section").click()
    tab = viewer.page.section
    tab.choice.value, tab.height.value = "axial", 165.0
    tab.show()
    viewer.page.jobs.wait(60.0)


def recording(viewer: Viewer, page: Page) -> None:
    """A recorded press."""
    tab = viewer.page.section
    tab.choice.value = "none"
    tab.show()
    page.get_by_role("tab", name="Recording").click()
    shown = viewer.page.recording
    assert shown is not None
    shown.frame.value = PRESSED
    viewer.state.show_frame(PRESSED)


VIEWS: dict[str, Callable[[Viewer, Page], None]] = {
    "viewer_probe": press,
    "viewer_section": section,
    "viewer_recording": recording,
}


def main() -> int:
    """Draw all; the exit status."""
    chromium = shutil.which("chromium") or shutil.which("chromium-browser")
    if chromium is None:
        print("no chromium here: the viewer's pictures were not drawn")
        return 0
    with sync_playwright() as play:
        browser = play.chromium.launch(
            executable_path=chromium,
            chromium_sandbox=os.geteuid() != 0,  # root has none
            args=[
                *("--use-gl=angle", "--use-angle=swiftshader"),
                *("--enable-unsafe-swiftshader", "--disable-component-update"),
            ],
        )
        served = guarded_server(0)
        fields, shown = shown_example(served)
        with tt.view(fields, served=served, **shown) as viewer:
            page = opened(browser, viewer, SIZE)
            for name, show in VIEWS.items():
                show(viewer, page)
                page.wait_for_timeout(DRAWN)
                save(page, name)
        with LivePage(port=0) as live:
            page = opened(browser, live.viewer, LIVE_SIZE)
            page.get_by_role("tab", name="Live").click()
            page.wait_for_timeout(LEARNED)
            while live.viewer.state.touches[0].wrench.force[1] < PRESSING:
                page.wait_for_timeout(10)
            save(page, "live_page")
        browser.close()
    return 0


def opened(browser: Browser, viewer: Viewer, size: tuple[int, int]) -> Page:
    """A page that has drawn all of a viewer."""
    page = browser.new_page(viewport={"width": size[0], "height": size[1]})
    page.set_default_timeout(PATIENCE)
    page.goto(viewer.url)
    page.wait_for_selector("canvas")
    viewer.page.jobs.wait(60.0)
    page.wait_for_timeout(DRAWN)
    note = page.locator(".mantine-Notification-closeButton")
    if note.count():  # that software draws
        note.first.click()
    return page


def save(page: Page, name: str) -> None:
    """What a page shows; a palette would lose a red arrow or make steps of a bar."""
    path = FOLDER / f"{name}.png"
    seen = Image.open(io.BytesIO(page.screenshot(timeout=PATIENCE)))
    seen.convert("RGB").save(path, optimize=True)
    print(path)


if __name__ == "__main__":
    sys.exit(main())

"""The page in a real browser, drawn by software: `make browser`.

What a visitor does with mouse and keys is compared with the state and the renderer;
pictures are slow to draw here, so no test looks at a pixel.
"""

import itertools
import os
import re
import shutil
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.viewer.conftest import field, probe, recorded
from tests.viewer.test_viewer import until
from ttus_opt.contact.standing import skin_points
from ttus_opt.viewer.first_camera import FirstCamera
from ttus_opt.viewer.guarded_server import guarded_server
from ttus_opt.viewer.viewer import ENDED

pytestmark = [pytest.mark.slow, pytest.mark.browser]
pytest.importorskip("viser", reason="needs ttus-opt[viewer]")
sync_api = pytest.importorskip("playwright.sync_api", reason="needs playwright")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser")
if CHROMIUM is None:
    pytest.skip("no chromium here", allow_module_level=True)

#: What a visitor waits at most: software draws a frame in a second or more [s]
PATIENCE = 120.0

PHONE, DESK = {"width": 390, "height": 700}, {"width": 900, "height": 560}

#: A phone draws more pixels than a page counts, and says that it is one
HELD = {"device_scale_factor": 3, "user_agent": "Mozilla/5.0 (Linux) Mobile"}

#: From now on no frame takes less than this [ms]
SLOWLY = """() => {
  const own = requestAnimationFrame;
  window.requestAnimationFrame = (draw) => own((now) => {
    for (const end = performance.now() + 40; performance.now() < end;);
    draw(now);
  });
}"""

#: Pixels of the canvas, of those of the page
SHARE = "(() => { const c = __viserMutable.canvas; return c.width / c.clientWidth })()"

#: viser's own, at every drag in Chromium; it has no effect
KNOWN = "Unable to preventDefault inside passive event listener invocation."

#: Three frames: a page takes an event, tells it, and draws
FRAMES = """async () => {
  for (let k = 0; k < 3; k++) await new Promise(requestAnimationFrame);
}"""

ARGUMENTS = (
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--disable-quic",
    "--disable-component-update",
)


@pytest.fixture(scope="module")
def browser():
    with sync_api.sync_playwright() as play:
        opened = play.chromium.launch(
            executable_path=CHROMIUM,
            chromium_sandbox=os.geteuid() != 0,  # root has none
            args=list(ARGUMENTS),
        )
        yield opened
        opened.close()


@pytest.fixture(scope="module")
def viewer():
    with tt.view(field(), probe(), recorded(), port=0) as opened:
        yield opened


class Visit:
    """A page and what went wrong in it."""

    def __init__(self, browser, url, size, **device):
        self.page = browser.new_page(viewport=size, **device)
        self.page.set_default_timeout(1e3 * PATIENCE)
        self.faults: list[str] = []
        self.asked: list[str] = []
        self.page.on(
            "console",
            lambda m: (
                m.type == "error" and m.text != KNOWN and self.faults.append(m.text)
            ),
        )
        self.page.on("pageerror", lambda error: self.faults.append(str(error)))
        self.page.on("request", lambda request: self.asked.append(request.url))
        self.page.on("websocket", lambda socket: self.asked.append(socket.url))
        self.page.goto(url)
        self.page.wait_for_selector("canvas")
        self.page.get_by_text("force", exact=True).first.wait_for()

    def until(self, true):
        """Wait, while the browser works, for something to become true."""
        end = time.monotonic() + PATIENCE
        while not true():
            assert time.monotonic() < end, "did not become true in time"
            self.page.wait_for_timeout(100)

    def drawn(self):
        """Wait for frames that show, and take, what was done before."""
        self.page.evaluate(FRAMES)
        self.page.wait_for_timeout(100)  # pages send drags 20 times a second

    def tab(self, name):
        self.page.get_by_role("tab", name=name).click()

    def field(self, handle):
        """Where one types the value of an input."""
        row = self.page.locator(f"[id='{handle._impl.uuid}']")
        return row.locator("xpath=..").locator("input:not([type=hidden])")

    def slide(self, handle, share):
        """Drag a slider's thumb to a share of its way."""
        row = self.page.locator(f"[id='{handle._impl.uuid}']").locator("xpath=..")
        row.get_by_role("slider").scroll_into_view_if_needed()
        track = row.locator("[class*=Slider-track]").first.bounding_box()
        thumb = row.get_by_role("slider").bounding_box()
        y, mouse = thumb["y"] + 0.5 * thumb["height"], self.page.mouse
        mouse.move(thumb["x"] + 0.5 * thumb["width"], y)
        mouse.down()
        for part in (0.5, 1.0):
            mouse.move(track["x"] + share * part * track["width"], y)
        mouse.up()


@pytest.fixture(scope="module")
def visit(browser, viewer):
    opened = Visit(browser, viewer.url, DESK)
    opened.until(lambda: cameras(viewer))
    yield opened
    opened.page.close()


def cameras(viewer, *, phone=False):
    """Cameras of the desk's pages, or of a phone's, in the order in which they came.

    The last visitor may be either: a page that was cut off comes back as a new one.
    """
    every = [one.camera for one in viewer._served.server.get_clients().values()]
    return [c for c in every if (c.image_width < 0.8 * c.image_height) == phone]


def pixel(viewer, point, *, phone=False):
    """Where a point of the scene is on the latest canvas [px]."""
    *_, camera = cameras(viewer, phone=phone)
    turn = Rotation.from_quat(camera.wxyz, scalar_first=True).as_matrix()
    x, y, z = turn.T @ (point - camera.position)
    focal = 0.5 * camera.image_height / np.tan(0.5 * camera.fov)
    return (
        float(0.5 * camera.image_width + focal * x / z),
        float(0.5 * camera.image_height + focal * y / z),
    )


def centre(viewer):
    """Middle of the probe."""
    rotation, position = viewer.state.pose
    return np.asarray(position + rotation @ probe().reference)


def felt(viewer):
    wrench = viewer.state.touches[0].wrench
    return np.concatenate([wrench.force, wrench.torque])


def rests(viewer):
    """Wait until what is felt is what the renderer gives where the hand is."""

    def alike():
        wrench = tt.Renderer(field(), probe()).render(*viewer.state.pose)
        expected = np.concatenate([wrench.force, wrench.torque])
        return bool(np.allclose(felt(viewer), expected, atol=1e-9))

    until(alike)


def test_a_click_puts_the_probe_there(visit, viewer):
    theta, z = np.array([1.9]), np.array([0.11])
    goal = skin_points(viewer.state.surface, theta, z)[0]

    def there():
        # a page that still draws its first frames takes no click
        visit.page.mouse.click(*pixel(viewer, goal))
        visit.page.wait_for_timeout(2000)
        return np.allclose(viewer.state.place, (1.9, 0.11), atol=0.02)

    visit.until(there)
    rests(viewer)


def drag(visit, viewer, way):
    """Take the probe by the mouse some way [m]."""
    rests(viewer)
    start, mouse = centre(viewer), visit.page.mouse
    mouse.move(*pixel(viewer, start))
    visit.drawn()
    mouse.down()
    visit.drawn()
    for share in np.linspace(0.0, 1.0, 8):
        mouse.move(*pixel(viewer, start + share * way))
        visit.drawn()
    mouse.up()
    visit.drawn()


def test_a_drag_moves_the_probe_over_the_skin(visit, viewer):
    viewer.state.slide(1.9, 0.11)
    before, depth, force = viewer.state.place, viewer.state.depth, felt(viewer)
    theta, z = np.array([before[0] - 0.3]), np.array([before[1] - 0.02])
    goal = skin_points(viewer.state.surface, theta, z)[0]
    own = skin_points(viewer.state.surface, *np.array(before)[:, None])[0]
    drag(visit, viewer, goal - own)
    moved = np.subtract(viewer.state.place, before)
    np.testing.assert_allclose(moved, [-0.3, -0.02], rtol=0.3)
    assert viewer.state.depth == pytest.approx(depth, abs=1e-5)
    rests(viewer)
    assert np.abs(felt(viewer) - force).max() > 0.01
    size = np.linalg.norm(felt(viewer)[:3])
    visit.page.get_by_text(f"{size:.2f}", exact=True).first.wait_for()


def test_a_drag_with_shift_presses_the_probe_in(visit, viewer):
    viewer.state.slide(1.6, 0.09)
    place, before = viewer.state.place, centre(viewer)
    events = []
    node = viewer.page.nodes[0].probe
    node.on_drag("left", modifier="shift")(events.append)
    way = -0.01 * viewer.state.outward
    visit.page.keyboard.down("Shift")
    drag(visit, viewer, way)
    visit.page.keyboard.up("Shift")
    np.testing.assert_allclose(viewer.state.place, place, atol=0.03)
    rests(viewer)
    gripped, moved = np.array(events[0].start_position), centre(viewer) - before
    assert moved @ way > 0.5 * way @ way
    # the point that was gripped is under the pointer, to a pixel along the way
    along = np.subtract(pixel(viewer, before + way), pixel(viewer, before))
    missed = np.subtract(pixel(viewer, gripped + moved), pixel(viewer, before + way))
    assert abs(missed @ along) < 1.0 * np.linalg.norm(along)


def test_keys_step_by_a_millimetre_and_a_degree(visit, viewer):
    depth, angles = viewer.state.depth, viewer.state.angles
    visit.page.mouse.move(5, 5)
    visit.page.keyboard.press("o")
    visit.until(lambda: abs(viewer.state.depth - depth - 1e-3) < 1e-6)
    visit.page.keyboard.press("Shift+O")
    visit.until(lambda: abs(viewer.state.angles[0] - angles[0] - 1.0) < 0.1)
    rests(viewer)


def test_fields_and_buttons_move_the_probe(visit, viewer):
    visit.tab("Probe")
    visit.field(viewer.page.probe._depth).fill("8")
    visit.until(lambda: abs(viewer.state.depth - 0.008) < 1e-6)
    visit.page.get_by_text("steps of 1 mm and 1°").click()
    visit.page.get_by_text("+ 1 mm", exact=True).last.click()
    visit.until(lambda: abs(viewer.state.depth - 0.009) < 1e-6)
    rests(viewer)


def test_the_section_follows_its_slider(visit, viewer):
    visit.tab("Section")
    choice = visit.page.locator("input[aria-haspopup=listbox]:visible")
    choice.click()
    visit.page.get_by_role("option", name="axial").click()
    tab = viewer.page.section
    visit.until(lambda: [one.up[1] for one in tab.shown] == [1.0])
    visit.field(tab.height).fill("70")
    visit.until(lambda: [round(one.origin[2], 9) for one in tab.shown] == [0.07])
    choice.click()
    visit.page.get_by_role("option", name="none").click()
    visit.until(lambda: tab.shown == [])


def test_a_click_on_the_plot_goes_to_that_pose(visit, viewer):
    visit.tab("Recording")
    plot = visit.page.locator(".u-over:visible")
    visit.page.wait_for_timeout(1500)  # the plot hears clicks half a second later
    box = plot.bounding_box()
    last = len(recorded()) - 1
    visit.page.mouse.click(
        box["x"] + 0.5 * box["width"], box["y"] + 0.5 * box["height"]
    )
    visit.until(lambda: viewer.state.source == "recording")
    assert abs(viewer.state.frame - last / 2) <= 1
    np.testing.assert_array_equal(
        viewer.state.pose[1], recorded().position[viewer.state.frame]
    )
    visit.page.get_by_text("a recorded pose").wait_for()


def test_two_pages_see_one_state(browser, visit, viewer):
    other = Visit(browser, viewer.url, DESK)
    other.tab("Probe")
    other.field(viewer.page.probe._depth).fill("6.5")
    for one in (other, visit):
        one.page.get_by_text("6.5", exact=True).first.wait_for()
    other.page.close()
    viewer.state.press(0.0045)  # the first page lives on
    visit.page.get_by_text("4.5", exact=True).first.wait_for()


def test_a_slow_page_draws_fewer_pixels_while_one_drags(browser, viewer):
    slow = Visit(browser, viewer.url, DESK)
    slow.page.evaluate(SLOWLY)
    slow.page.mouse.move(100, 300)
    slow.page.mouse.down()
    x = itertools.count(100)

    def fewer():
        slow.page.mouse.move(next(x) % 400, 300)
        return slow.page.evaluate(SHARE) < 0.55

    slow.until(fewer)
    slow.page.mouse.up()
    slow.until(lambda: slow.page.evaluate(SHARE) > 0.95)
    slow.page.close()
    assert slow.faults == []


@pytest.mark.parametrize(
    ("height", "device"), [(700, {}), (600, HELD)], ids=["narrow", "phone"]
)
def test_a_phone_is_wide_enough(browser, viewer, height, device):
    phone = Visit(browser, viewer.url, PHONE | {"height": height}, **device)
    width = phone.page.evaluate("document.documentElement.scrollWidth")
    assert width <= PHONE["width"]
    phone.until(lambda: cameras(viewer, phone=True))

    def in_sight():  # beside and above the panel
        skin = viewer.page.nodes[0].skin.vertices
        x, y = np.transpose([pixel(viewer, point, phone=True) for point in skin[::7]])
        *_, camera = cameras(viewer, phone=True)
        seen = x.min() > 0 and x.max() < camera.image_width and y.min() > 0
        return bool(seen and y.mean() < 0.3 * camera.image_height)

    phone.until(in_sight)
    phone.page.close()
    assert phone.faults == []


def test_nothing_else_is_asked_for_and_no_error_is_shown(visit):
    hosts = {
        urlsplit(url).hostname
        for url in visit.asked
        if not url.startswith(("data:", "blob:"))
    }
    assert hosts == {"127.0.0.1"}
    assert visit.faults == []


def test_another_host_cannot_be_asked(visit):
    """The browser itself refuses, by the page's policy."""
    answer = visit.page.evaluate(
        "fetch('http://127.0.0.2:9/').then(() => 'sent', e => String(e))"
    )
    assert re.search("Failed to fetch", answer)
    visit.until(lambda: any("Content Security Policy" in f for f in visit.faults))
    visit.faults.clear()


def test_a_page_that_is_open_first_gets_field_and_camera_and_is_told_the_end(browser):
    served = guarded_server(0)
    page = browser.new_page(viewport=DESK)
    page.set_default_timeout(1e3 * PATIENCE)
    page.goto(served.url)
    page.wait_for_selector("canvas")
    while not served.server.get_clients():
        page.wait_for_timeout(100)
    with tt.view(field(), probe(), served=served) as one:
        page.get_by_text("force", exact=True).first.wait_for()
        surface = one.state.surface
        ours, _ = FirstCamera.of(surface, float(np.ptp(surface.z))).cameras[0]
        end = time.monotonic() + PATIENCE
        while not any(np.allclose(c.position, ours, atol=1e-3) for c in cameras(one)):
            assert time.monotonic() < end, "the camera stays where it was"
            page.wait_for_timeout(100)
    page.get_by_text(ENDED).wait_for()
    page.close()


def test_a_live_session_is_stopped_armed_again_and_delayed(browser):
    pytest.importorskip("msgspec", reason="needs ttus-opt[live]")
    from ttus_opt.live.trial import Trial
    from ttus_opt.viewer.live_page import LivePage

    with LivePage(Trial(round_trip=0.1), port=0) as live:
        session, visit = live.session, Visit(browser, live.viewer.url, DESK)
        visit.tab("Live")
        visit.page.get_by_text("NORMAL", exact=True).wait_for()
        visit.until(lambda: np.linalg.norm(session.view().force) > 1.0)
        visit.page.get_by_role("button", name="STOP", exact=True).click()
        visit.page.get_by_text("STOP: the operator's button").wait_for()
        visit.until(lambda: not np.any(session.view().force))
        visit.page.get_by_text("the simulated hand presses").click()
        live.viewer.state.press(-0.02)  # lifted
        again = visit.page.get_by_role("button", name="re-arm, at zero contact")

        def armed():  # refused, with a word, until there is no contact
            again.click()
            visit.page.wait_for_timeout(1000)
            return session.view().state == "NORMAL"

        visit.until(armed)

        def delayed():  # the panel may still move below the pointer
            visit.slide(live.tab.delay, 0.8)
            visit.page.wait_for_timeout(500)
            return abs(session.trial.round_trip - 0.8) < 0.05

        visit.until(delayed)
        visit.until(lambda: abs(session.view().round_trip - 0.8) < 0.15)
        visit.page.get_by_text(re.compile(r"^[78]\d\d ms, 0 %")).wait_for()
        visit.page.close()
        assert visit.faults == []

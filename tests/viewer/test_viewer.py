"""A served page without a browser: what it sends, and that it ends."""

import io
import json
import struct
import threading
import time
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

import ttus_opt as tt
from tests.kit import is_free, own_port, torso
from tests.viewer.conftest import field, probe, recorded
from ttus_opt.core.errors import InputError
from ttus_opt.probe.mesh import TriangleMesh
from ttus_opt.viewer import colouring
from ttus_opt.viewer.arrow import STEP, TIP
from ttus_opt.viewer.colour_map import UNKNOWN, node_colours
from ttus_opt.viewer.colouring import Colouring
from ttus_opt.viewer.first_camera import FirstCamera
from ttus_opt.viewer.guarded_server import guarded_server
from ttus_opt.viewer.looks import lit
from ttus_opt.viewer.page import along_line
from ttus_opt.viewer.patient_nodes import PatientNodes, patients_on
from ttus_opt.viewer.viewer import Viewer, probe_of

pytest.importorskip("viser", reason="needs ttus-opt[viewer]")


def until(true, seconds=60.0):
    """Wait for something to become true."""
    end = time.monotonic() + seconds
    while not true():
        assert time.monotonic() < end, "did not become true in time"
        time.sleep(0.02)


def vertex_colours(glb):
    """COLOR_0 of a binary glTF of one mesh, red, green and blue."""
    (length,) = struct.unpack_from("<I", glb, 12)
    tree = json.loads(glb[20 : 20 + length])
    accessor = tree["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    about = tree["accessors"][accessor]
    start = 28 + length + tree["bufferViews"][about["bufferView"]]["byteOffset"]
    data = np.frombuffer(glb, np.uint16, 4 * about["count"], start)
    return data.reshape(-1, 4)[:, :3]


@pytest.fixture(scope="module")
def viewer():
    both = [field(), field(2.0)]
    with tt.view(both, probe(), recorded(), names=["one", "two"], port=0) as open_one:
        assert open_one.page.jobs.wait(30.0)
        yield open_one


def test_the_colour_of_a_node_is_that_of_its_value(viewer):
    skin = viewer.page.skin
    skin.show("Stiffness")
    assert viewer.page.jobs.wait(30.0)
    lows, highs = zip(*(one.span for one in skin.colourings("Stiffness")), strict=True)
    span = min(lows), max(highs)  # one scale for both fields
    for nodes, found in zip(
        viewer.page.nodes, skin.colourings("Stiffness"), strict=True
    ):
        mesh = trimesh.load_mesh(io.BytesIO(nodes._mesh.glb_data), "glb", process=False)
        white = np.full((len(mesh.vertices), 3), 255, np.uint8)
        light = lit(white, viewer.page.nodes[0].skin.normals, torso().front)
        sent = vertex_colours(nodes._mesh.glb_data) / 65_535 / light
        shown = np.where(
            sent < 0.0031308, 12.92 * sent, 1.055 * sent ** (1 / 2.4) - 0.055
        )
        expected = node_colours(found, span) / 255.0
        np.testing.assert_allclose(shown, expected, atol=0.01)  # of 1, no more is sent
        np.testing.assert_allclose(
            mesh.vertices, viewer.page.nodes[0].skin.vertices, atol=1e-6
        )


@pytest.mark.slow
def test_the_probe_goes_where_the_hand_is(viewer):
    viewer.state.slide(2.0, 0.08)
    viewer.state.press(0.009)
    until(
        lambda: np.allclose(
            viewer.page.nodes[0].probe.position, viewer.state.pose[1], atol=1e-9
        )
    )
    until(lambda: "9.0" in viewer.page._numbers.content)
    for touch, name in zip(viewer.state.touches, ("one", "two"), strict=True):
        size = np.linalg.norm(touch.wrench.force)
        until(lambda size=size: f"<b>{size:.2f}</b>" in viewer.page._numbers.content)
        assert name in viewer.page._numbers.content
    until(lambda: viewer.page.probe._depth.value == 9.0)
    arrow, touch = viewer.page.nodes[1]._force, viewer.state.touches[1]
    until(lambda: np.allclose(arrow._frame.position, touch.centre, atol=1e-9))
    np.testing.assert_allclose(drawn(arrow), 0.008 * touch.wrench.force, atol=1e-9)


def drawn(arrow):
    """From the start of an arrow to its tip; its shaft ends within its head."""
    turn = Rotation.from_quat(arrow._frame.wxyz, scalar_first=True)
    head, *across, shaft = *np.asarray(arrow._head.position)[2:], *arrow._shaft.scale
    assert across == [1.0, 1.0]
    assert head < shaft <= head + STEP + 1e-12
    return turn.apply([0.0, 0.0, head + arrow._head.scale * TIP])


def test_a_skin_is_drawn_once_and_before_its_probe():
    served = guarded_server(0)
    (nodes,) = patients_on(served, field().voxmap.surface, 1)
    drawn, without = nodes._mesh, nodes.probe is None
    with tt.view(field(), probe(), served=served) as one:
        assert without and nodes.probe is not None
        assert one.page.nodes[0] is nodes and nodes._mesh is drawn


def test_arrows_are_drawn_from_what_can_be_felt(viewer):
    skin, touch = viewer.page.nodes[0].skin, viewer.state.touches[0]
    at = np.zeros(3), FirstCamera.of(torso(), 0.2)
    # apart from those that the page moves
    nodes = PatientNodes(viewer._served.server.scene, "alone", skin, *at)
    nodes.add_probe(TriangleMesh(probe().points, np.arange(3)[None]), (0, 0, 0))
    for torque, is_shown in ((1e-4, False), (4e-4, True)):
        wrench = replace(touch.wrench, torque=np.array([torque, 0.0, 0.0]))
        nodes.show_touch(replace(touch, wrench=wrench), np.full(3, 0.01))
        assert nodes._torque._frame.visible is is_shown
        assert not nodes._measured._frame.visible
    # 0.3 mm: the shortest arrow there is
    np.testing.assert_allclose(drawn(nodes._torque), [STEP, 0.0, 0.0], atol=1e-9)


def test_sections_follow_and_cut_the_skin_open(viewer):
    tab, nodes = viewer.page.section, viewer.page.nodes[0]
    whole = len(nodes._faces)
    tab.choice.value = "axial"
    for height in (60.0, 120.0):
        tab.height.value = height
        tab.show()
        assert viewer.page.jobs.wait(20.0)
        assert tab.shown[0].origin[2] == pytest.approx(1e-3 * height)
        assert nodes._image.position[2] == pytest.approx(1e-3 * height)
    assert len(nodes._faces) < 0.8 * whole
    tab.choice.value = "none"
    tab.show()
    assert viewer.page.jobs.wait(20.0)
    assert len(nodes._faces) == whole
    assert not nodes._image.visible


@pytest.mark.slow
def test_a_recording_plays_to_its_end(viewer):
    tab = viewer.page.recording
    tab._go(0)
    tab.playing.value = True
    until(lambda: not tab.playing.value)
    assert viewer.state.frame == len(recorded()) - 1
    until(lambda: "a recorded pose" in viewer.page._numbers.content)
    viewer.state.press(0.004)
    until(lambda: "moved by hand" in viewer.page._numbers.content)
    assert (
        'measured</td><td style="text-align:right">–<' in viewer.page._numbers.content
    )


def test_what_a_colouring_needs_is_said(viewer):
    viewer.page.skin.show("Next press")
    until(lambda: "tt.uncertainty" in viewer.page.skin._legend.content)
    for nodes in viewer.page.nodes:  # no colours without a legend
        assert (nodes._colours == UNKNOWN).all()
    viewer.page.skin.show("Uncertainty")
    until(lambda: "of its force [%]" in viewer.page.skin._legend.content)
    viewer.page.skin.show("Seen")
    until(lambda: "filled in" in viewer.page.skin._legend.content)


def test_a_colouring_that_fails_is_not_waited_for(viewer, monkeypatch):
    monkeypatch.setitem(viewer.page.skin._ways, "Fails", lambda: 1 / 0)
    viewer.page.skin.show("Fails")
    until(lambda: "not computed" in viewer.page.skin._legend.content)


def test_where_to_press_next_is_computed_when_it_is_looked_at(monkeypatch):
    asked = []

    def found(stated, skin):
        values, marks = np.ones(len(skin.theta)), skin.vertices[:2]
        return Colouring("spread", "N", values, marks=marks)

    def stated():
        asked.append("once")
        return object()

    monkeypatch.setattr(colouring, "next_presses", found)
    with tt.view(field(), probe(), port=0, uncertainty=stated) as one:
        assert one.page.jobs.wait(30.0)
        assert asked == []
        for name, shown in (("Next press", 2), ("Seen", 0), ("Next press", 2)):
            one.page.skin.show(name)
            assert one.page.jobs.wait(30.0)
            marks = one.page.nodes[0]._marks
            assert len(marks) == shown
            assert ("1 to 2: press" in one.page.skin._legend.content) == bool(shown)
        assert asked == ["once"]


def test_colours_of_a_field_that_was_replaced_meanwhile_are_computed_again():
    with tt.view(field(), probe(), port=0) as one:
        tab, asked = one.page.skin, []
        assert one.page.jobs.wait(30.0)

        def seen():
            asked.append(tab._legend.content)
            if len(asked) == 1:  # the field is replaced while this goes on
                tab.forget()
            return [colouring.seen(field(), one.page.nodes[0].skin)]

        tab._ways["Seen"] = seen
        tab.choice.value = "Seen"
        tab.show("Seen")
        assert one.page.jobs.wait(30.0)
        assert ["computing" in told for told in asked] == [True, False]


def test_the_running_plots_are_level_while_nothing_moves(monkeypatch):
    monkeypatch.setattr(Viewer, "_run", lambda _: None)  # this test's clock alone
    with tt.view(field(), probe(), port=0) as one:
        tab, points = one.page.probe, one.page.probe._points
        tab.add_point(90.0)
        (time, force), _ = tab.columns()
        np.testing.assert_array_equal(time, [-10.0, 0.0])
        assert force[0] == force[1] > 0.1
        points.clear()
        points.append((100.0, [1.0, 20.0]))
        tab.add_point(100.03)  # too soon
        tab.add_point(104.0)
        (time, force), (same, torque) = tab.columns()
        np.testing.assert_allclose(time, [-4.0, -0.05, 0.0], atol=1e-9)
        np.testing.assert_array_equal(same, time)
        wrench = tt.Renderer(field(), probe()).render(*one.state.pose)
        pushed, turned = np.linalg.norm([wrench.force, wrench.torque], axis=1)
        assert turned > 5e-5
        np.testing.assert_allclose(force, [1.0, 1.0, pushed])
        np.testing.assert_allclose(torque, [20.0, 20.0, 1e3 * turned])
        tab.draw()
        labels = [plot.axes[1]["label"] for plot in tab.plots]
        assert labels == ["force [N]", "torque [mN m]"]
        drawn = [np.asarray(plot.data[1]) for plot in tab.plots]
        np.testing.assert_allclose(drawn, [force, torque], rtol=1e-6)
        tab.add_point(113.99)
        (time, force), _ = tab.columns()
        np.testing.assert_allclose(time, [-10.0, -9.99, -0.05, 0.0], atol=1e-9)
        assert force[0] == 1.0


def test_a_plot_is_sent_again_where_another_frame_is_marked(monkeypatch):
    monkeypatch.setattr(Viewer, "_run", lambda _: None)
    with tt.view(field(), probe(), recorded(), port=0) as one:
        tab, sent = one.page.recording, []
        monkeypatch.setattr(tab, "_columns", lambda frame: sent.append(frame) or ())
        for frame in (3, 3, 5):
            one.state.show_frame(frame)
            tab.draw()
        for depth in (0.004, 0.006):
            one.state.press(depth)
            tab.draw()
        assert sent == [3, 5, None]


def test_a_fault_is_told_and_the_page_goes_on(viewer, monkeypatch):
    told = []
    monkeypatch.setattr(viewer.page, "tell", told.append)

    def broken():
        raise RuntimeError("no numbers")

    monkeypatch.setattr(viewer.page, "write", broken)
    viewer.state.press(0.006)
    until(lambda: told == ["RuntimeError: no numbers"])
    monkeypatch.undo()
    viewer.state.press(0.007)
    until(lambda: "7.0" in viewer.page._numbers.content)


def test_a_new_field_is_shown(viewer):
    with tt.view(field(), probe(), port=0) as one:
        before = np.linalg.norm(one.state.touches[0].wrench.force)
        one.update(field(3.0))
        until(
            lambda: np.isclose(
                np.linalg.norm(one.state.touches[0].wrench.force), 3.0 * before
            )
        )


def test_it_closes_twice_and_frees_its_port():
    port = own_port()
    one = tt.view(field(), probe(), port=port)
    assert one._served.server.get_port() == port
    one.close()
    one.close()
    until(lambda: is_free(port))  # viser waits a second at most for its thread
    again = tt.view(field(), probe(), port=port)
    assert again._served.server.get_port() == port
    assert again.url != one.url
    again.close()


@pytest.mark.slow
def test_a_notebook_shows_the_page():
    named = replace(field(), provenance={"probe": "ellipsoid:0.02,0.015,0.015"})
    with named.view(port=0) as one:
        assert one.state.shell is not None  # of the provenance
        assert f'<iframe src="{one.url}"' in one._repr_html_()
        assert one.url in repr(one)


def test_a_probe_is_taken_from_the_provenance_where_it_says_all():
    for spec, points in (("sphere:0.02", 1500), ("probe.stl", None), ("", None)):
        found = probe_of(replace(field(), provenance={"probe": spec}))
        assert (found and len(found)) == points


def test_without_a_probe_one_looks_only():
    with tt.view(field(), port=0) as one:
        assert one.page.probe is None
        assert one.page.jobs.wait(20.0)
        assert "no probe" in one.page._numbers.content
        assert one.page.skin.choice.options == ("Seen", "Uncertainty")


def test_names_are_as_many_as_fields():
    with pytest.raises(InputError, match="as many names"):
        tt.view([field(), field(2.0)], probe(), names=["one"], port=0)


def test_a_pointer_is_followed_along_a_line():
    rng = np.random.default_rng(3)
    point, way = np.array([0.1, -0.2, 0.6]), rng.normal(size=3)
    way /= np.linalg.norm(way)
    for out in rng.uniform(-0.1, 0.1, 5):
        # through the moved point, and beside it: the nearest of the plane counts
        ray = 3.0 * (point + out * way)
        aside = ray + np.cross(point, way)
        assert along_line(point, way, ray) == pytest.approx(out)
        assert along_line(point, way, aside) == pytest.approx(out)
    assert along_line(np.array([0, 0, 0.5]), np.array([0, 0, 1.0]), ray) == 0.0
    along = point / np.linalg.norm(point)
    near = along + 0.01 * np.cross(along, [0.0, 1.0, 0.0])
    assert abs(along_line(point, near / np.linalg.norm(near), ray)) < 0.1


def test_a_colouring_that_takes_long_holds_up_no_other():
    with tt.view(field(), probe(), port=0) as one:
        tab, go_on = one.page.skin, threading.Event()
        assert one.page.jobs.wait(30.0)

        def slow():
            assert go_on.wait(30.0)
            return [colouring.uncertainty(field(), one.page.nodes[0].skin)]

        tab._ways["Uncertainty"] = slow
        tab.show("Uncertainty")
        tab.show("Seen")
        until(lambda: "seen by the scan" in tab._legend.content)
        painted = one.page.nodes[0]._mesh.glb_data
        go_on.set()
        assert one.page.jobs.wait(30.0)
        assert "seen by the scan" in tab._legend.content
        assert one.page.nodes[0]._mesh.glb_data is painted
        assert "Uncertainty" in tab._known

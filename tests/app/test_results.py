"""A campaign's results on the robot in the page."""

import json
import re
import struct
import threading

import numpy as np
import pytest
from mouse import pushed
from vclient import VClient, until

from app.__main__ import main
from app.browser import opened
from app.campaign import summary
from app.campaign.command import TABLE
from app.serve import results
from app.serve.access import Access
from app.serve.main import Page
from app.serve.results import LABEL, LINKS, read, skins
from hrc import meshes
from hrc.errors import HrcError
from hrc.messages import LINKS as LINK_NAMES

METRIC = "force_error_N"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Of link 4 it is known that the force is off by 5 N on one side and by none on the other."""
    out = tmp_path_factory.mktemp("results")
    points = meshes.robot("perception")[4].vertices[::7]
    summary.write(out / TABLE, [{"link": 4, "p_link_m": p.tolist(), METRIC: 5.0 if p[0] > 0.0 else 0.0} for p in points])
    return out


@pytest.fixture(scope="module")
def page(folder):
    page = Page("free", Access(port=0), say=lambda _: None, results=folder)
    page.start()
    yield page
    page.close()


def of(glb):
    """The description of a GLB file."""
    length, kind = struct.unpack_from("<II", glb, 12)
    assert kind == 0x4E4F534A
    return json.loads(glb[20 : 20 + length])


def test_the_surface_has_the_colours_of_what_was_found(folder):
    (field,) = read(folder)
    link = meshes.robot("perception")[4]
    assert np.nanmedian(field.values[4][link.vertices[:, 0] > 0.05]) > 4.0
    assert np.nanmedian(field.values[4][link.vertices[:, 0] < -0.05]) < 1.0
    assert np.isnan(field.values[6]).all()
    glbs = skins(field)
    assert len(glbs) == 8
    for glb in glbs:
        tree = of(glb)
        (part,) = tree["meshes"][0]["primitives"]
        assert {"POSITION", "NORMAL", "COLOR_0"} <= set(part["attributes"])
        assert tree["materials"][part["material"]]["pbrMetallicRoughness"]["metallicFactor"] == 0.0


def test_each_vertex_has_the_colour_of_its_place(folder):
    (field,) = read(folder)
    link, glb = meshes.shaded(meshes.robot("perception")[4]), skins(field)[4]
    tree = of(glb)
    (part,) = tree["meshes"][0]["primitives"]
    accessor = tree["accessors"][part["attributes"]["COLOR_0"]]
    view = tree["bufferViews"][accessor["bufferView"]]
    assert (accessor["componentType"], accessor["count"]) == (5121, len(link.vertices)), "bytes, one colour for each vertex"
    start = 20 + struct.unpack_from("<I", glb, 12)[0] + 8 + view.get("byteOffset", 0)
    rgba = np.frombuffer(glb, np.uint8, view["byteLength"], start).reshape(len(link.vertices), -1).astype(float)
    one, other = link.vertices[:, 0] > 0.05, link.vertices[:, 0] < -0.05
    assert rgba[one, 0].mean() > 2.0 * rgba[one, 2].mean()
    assert rgba[other, 2].mean() > 2.0 * rgba[other, 0].mean()


@pytest.mark.parametrize(("make", "said"), [
    (lambda path: path, "no results of a campaign"),
    (lambda path: path / "nowhere", "no results of a campaign"),
    (lambda path: (path / TABLE).write_text("no table") and path, "no results of a campaign"),
    (lambda path: summary.write(path / TABLE, [{"link": 4, "p_link_m": [0.0] * 3, "missed": None}]) or path, "none of the"),
], ids=["empty", "missing", "broken", "without"])
def test_what_are_no_results_is_said_before_anything_is_served(make, said, tmp_path, capsys):
    path = make(tmp_path)
    with pytest.raises(HrcError, match=said):
        read(path)
    with pytest.raises(SystemExit) as exit_:
        main(["serve", "--port", "auto", "--results", str(path)])
    assert exit_.value.code == 2
    assert said in capsys.readouterr().err


def robot(page):
    """The nodes of its links."""
    return [page.server.scene._handle_from_node_name[f"/robot/{name}"] for name in LINK_NAMES]


@pytest.mark.live
def test_the_choice_colours_the_robot_and_takes_it_back(page):
    client = VClient(page.server.get_port())
    until(lambda: client.ready.is_set() and client.seat() and "position" in client.nodes.get("/robot/link_4", {}))
    until(lambda: client.banner()["mode"] == "idle")
    client.set(LABEL, METRIC)
    until(lambda: "/robot/link_4/results" in client.nodes and f'data-metric="{METRIC}"' in client.text())
    assert {node.opacity for node in robot(page)} == {0.0}, "the skins are seen, and the links are still there to be pushed"
    client.set(LABEL, LINKS)
    until(lambda: "data-metric" not in client.text())
    assert {node.opacity for node in robot(page)} == {None}
    assert not any("results" in name for name in page.server.scene._handle_from_node_name)
    client.close()


@pytest.mark.live
def test_a_choice_that_was_taken_back_before_it_was_drawn_is_not_shown(page, monkeypatch):
    begun, go_on = threading.Event(), threading.Event()

    def slow(field):
        begun.set()
        assert go_on.wait(10.0)
        return skins(field)

    client = VClient(page.server.get_port())
    until(lambda: client.ready.is_set() and client.banner()["mode"] == "idle" and client.widget(LABEL))
    monkeypatch.setattr(results, "skins", slow)
    client.set(LABEL, METRIC)
    assert begun.wait(5.0)
    client.set(LABEL, LINKS)
    until(lambda: page.server.gui._gui_input_handle_from_uuid[client.widget(LABEL)].value == LINKS)
    go_on.set()
    beat = int(client.banner()["beat"])
    until(lambda: int(client.banner()["beat"]) > beat + 20)
    assert {node.opacity for node in robot(page)} == {None}
    assert "data-metric" not in client.text()
    client.close()


@pytest.mark.live
@pytest.mark.browser
def test_a_robot_in_other_colours_can_be_pushed(page, chromium):
    tab = opened(chromium, page.url)
    tab.get_by_role("tab", name="View").click()
    tab.get_by_label(LABEL).click()
    tab.get_by_role("option", name=METRIC).click()
    tab.wait_for_selector(f'#eb-results[data-metric="{METRIC}"]')
    tab.wait_for_function("() => window.__viserMutable.nodeRefFromName['/robot/link_4/results']")
    tab.get_by_role("tab", name=re.compile("Contact")).click()
    assert any(pushed(tab) for _ in range(6)), "the banner never said RELAX or ABORT"
    tab.mouse.up()

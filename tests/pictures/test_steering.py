"""A character is steered in a browser that cannot reach the network."""

from __future__ import annotations

import random
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import blended
import numpy as np
import pytest
from chromium import Page, executable, offline_page
from test_motion_html import changed, picture, press

import octo
from octo.model.kinematics import body_poses
from octo.motion_graph import MotionGraph

pytestmark = [
    pytest.mark.skipif(executable() is None, reason="no chromium or google-chrome is installed"),
    pytest.mark.timed,
]
STEP = 0.02  # s, of the page's clock where a test drives it


@pytest.fixture(scope="module")
def graph(tmp_path_factory: pytest.TempPathFactory) -> MotionGraph:
    return blended.graph(tmp_path_factory.mktemp("graph") / "graph.db", blended.made_up())


@pytest.fixture
def page(graph: MotionGraph, tmp_path: Path) -> Iterator[Page]:
    """The page, once its scene is there; its clock stands still."""
    file, program = tmp_path / "graph.html", executable()
    octo.view(graph, file)
    assert program is not None
    with offline_page(program, tmp_path / "profile") as page:
        page.call("Page.navigate", url=f"{file.as_uri()}?fixedDpr=1")
        page.wait_for("window.octoSteer !== undefined && octoSteer.ready")
        page.evaluate("octoSteer.playing && octoSteer.change('playing')")
        yield page
        assert page.errors == []
        assert [
            url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))
        ] == []


def advance(page: Page, seconds: float) -> None:
    """Drive the page's clock, in steps as a browser does."""
    count = round(seconds / STEP)
    page.evaluate(f"for (let k = 0; k < {count}; k++) octoSteer.advance({STEP}); 0")


def state(page: Page) -> dict[str, Any]:
    return dict(page.evaluate("octoSteer.state"))


def shown(page: Page) -> str:
    """What the page says that the character does."""
    return str(page.evaluate("document.querySelector('[data-octo=now]').textContent"))


def trunk(page: Page) -> list[float]:
    """m, where the trunk is in the scene that is drawn."""
    name = "/world/robot/0_trunk"
    path = f"window.__viserMutable.nodeRefFromName['{name}']"
    page.wait_for(f"{path} !== undefined")
    time.sleep(0.5)  # until the messages are worked off
    return list(page.evaluate(f"(() => {{ const p = {path}.position; return [p.x, p.y, p.z] }})()"))


def longest_arrow(page: Page) -> float:
    """m, of the contact forces now."""
    return float(
        page.evaluate(
            "(() => { const w = octoSteer.walker; return Math.max(...w.data.contacts.map((_, c) => "
            "Math.hypot(...(w.force(c, w.step) ?? [0])))) })()"
        )
    )


def another(page: Page, before: np.ndarray, share: float) -> np.ndarray:
    """The picture, once so much of it is another one: a frame takes a busy machine long."""
    for _ in range(30):
        after = picture(page)
        if changed(before, after) > share:
            return after
    raise AssertionError("the picture does not change")


def test_each_key_and_button_makes_it_do_its_motion(page: Page) -> None:
    advance(page, 2.0)
    assert shown(page) == "walk" and state(page)["plan"] is None
    x = state(page)["x"]
    advance(page, 1.0)
    walked = state(page)
    assert walked["x"] - x == pytest.approx(0.5, abs=0.1)  # it travels at 0.5 m/s
    press(page, "ArrowLeft")
    plan = state(page)["plan"]
    assert shown(page) == "walk" and state(page)["wanted"] == "left"
    assert 0.0 <= plan["begins"] <= 0.5 and plan["there"] == pytest.approx(plan["begins"] + 1.0)
    said = page.evaluate("document.querySelector('[data-octo=next]').textContent")
    assert said.startswith("left: begins in ") and said.endswith(f"{plan['there']:.1f} s")
    advance(page, plan["begins"] + 0.1)
    assert shown(page) == "walk → left"
    advance(page, 1.0)
    assert shown(page) == "left" and state(page)["plan"] is None
    before = state(page)
    advance(page, 1.0)
    after = state(page)
    assert abs(after["heading"] - before["heading"]) > 0.4  # it turns at 0.6 rad/s
    assert np.hypot(after["x"] - before["x"], after["y"] - before["y"]) < 0.1
    x, y = page.evaluate(
        "(() => { const box = document.querySelector('[data-motion=jump]')"
        ".getBoundingClientRect(); return [box.left + 9, box.top + 9] })()"
    )
    page.call("Input.dispatchTouchEvent", type="touchStart", touchPoints=[{"x": x, "y": y}])
    page.call("Input.dispatchTouchEvent", type="touchEnd", touchPoints=[])
    page.wait_for("octoSteer.state.wanted === 'jump'")
    advance(page, 2.6)
    assert shown(page) == "jump"
    press(page, "1")
    advance(page, 2.6)
    assert shown(page) == "walk"


def test_what_is_drawn_is_what_kinematics_says(page: Page, graph: MotionGraph) -> None:
    """Along the first motion the page's place is that of the file."""
    page.evaluate("octoSteer.advance(1.3 - octoSteer.walker.clock); 0")
    motion = graph.motions["walk"]
    x = motion.x[1 + 52]  # 1.3 s from its start
    assert motion.character is not None
    origin = body_poses(motion.character, x)[1][0]
    start = motion.x[1, :2]
    c, s = np.cos(motion.x[1, 3]), np.sin(motion.x[1, 3])
    wanted = np.array([[c, s], [-s, c]]) @ (origin[:2] - start)
    assert trunk(page) == pytest.approx([*wanted, origin[2]], abs=1e-3)


def test_sixty_seconds_of_any_choice_without_an_error(page: Page) -> None:
    """Far enough that the page moves its origin; a motion that is wanted is there soon."""
    page.evaluate("octoSteer.data.ground.repeats = 0.05; 0")
    keys = {"ArrowUp": "walk", "ArrowLeft": "left", " ": "jump"}
    chosen = random.Random(1)
    for _ in range(10):
        key = chosen.choice(list(keys))
        press(page, key)
        there = (state(page)["plan"] or {"there": 0.0})["there"]
        assert there <= 2.5 + 1e-6  # to the end, from where a loop alone leads, and from it
        before = state(page)
        for _ in range(6):
            advance(page, 1.0)
            now = state(page)
            assert np.hypot(now["x"] - before["x"], now["y"] - before["y"]) < 2.0
            before = now
        assert before["wanted"] == keys[key]
        assert (
            np.hypot(*page.evaluate("[octoSteer.walker.place.x, octoSteer.walker.place.y]")) < 4.0
        )
    assert state(page)["clock"] >= 60.0


def test_it_stays_in_its_motion_for_ever(page: Page) -> None:
    press(page, "ArrowLeft")
    advance(page, 2.6)
    for _ in range(20):
        advance(page, 3.0)
        assert shown(page) == "left"


@pytest.mark.parametrize("plain", [True, False])
def test_what_it_does_is_seen(page: Page, plain: bool) -> None:
    """In both looks; the first is that of a computer without a graphics card, as here."""
    assert page.evaluate("octoSteer.plain")
    page.evaluate(f"octoSteer.plain = {str(plain).lower()}; octoSteer.show(); 0")
    page.evaluate("octoSteer.advance(2.0 - octoSteer.walker.clock); 0")
    before = picture(page)
    press(page, "ArrowLeft")
    advance(page, 2.6)
    lengths = [longest_arrow(page)]
    while len(lengths) < 50 or lengths[-1] < 0.8 * max(lengths):
        advance(page, STEP)
        lengths.append(longest_arrow(page))
        assert len(lengths) < 500, f"no force as long as one was before, {max(lengths):.3f} m"
    after = another(page, before, 0.01)
    assert after.std() > 0.02, "nothing is drawn"
    press(page, "f")
    another(page, after, 2e-4)


def test_forces_looks_and_pause_have_keys(page: Page) -> None:
    advance(page, 1.0)
    arrows = "window.__viserMutable.nodeRefFromName['/world/forces']"
    assert page.evaluate(f"{arrows} !== undefined")
    pressed = "document.querySelector('[data-octo={}]').getAttribute('aria-pressed')"
    for key, name in (("f", "forces"), ("l", "plain"), ("c", "turns"), ("p", "playing")):
        before = page.evaluate(pressed.format(name))
        press(page, key)
        assert page.evaluate(pressed.format(name)) != before
    page.wait_for("octoSteer.walker.clock > 1.5")  # it plays again
    assert page.evaluate("octoSteer.walker.prints.length") > 4

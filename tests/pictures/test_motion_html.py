"""motion.html in a browser that cannot reach the network."""

from __future__ import annotations

import dataclasses
import io
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import motions
import numpy as np
import pytest
from chromium import Page, executable, offline_page
from matplotlib.image import imread

from octo.model.gallery import CHARACTERS
from octo.result.solution import Solution
from octo.viewer import view

STEPS, DT = 120, 0.025
pytestmark = [
    pytest.mark.skipif(executable() is None, reason="no chromium or google-chrome is installed"),
    pytest.mark.timed,
]


@contextmanager
def opened(solution: Solution, folder: Path, **options: bool) -> Iterator[Page]:
    """The page of ``solution``, once its scene is there."""
    file, program = folder / "motion.html", executable()
    view(solution, file, **options)
    assert program is not None
    with offline_page(program, folder / "profile") as page:
        page.call("Page.navigate", url=f"{file.as_uri()}?fixedDpr=1")
        page.wait_for("window.octoPlayer !== undefined && octoPlayer.ready")
        yield page
        assert page.errors == []
        assert [
            url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))
        ] == []


def shown(page: Page) -> float:
    """s, what the page says."""
    return float(page.evaluate("document.querySelector('[data-octo=time]').textContent"))


def cursor(page: Page) -> float:
    """s, where the cursor stands between the two ends of the time line."""
    left, width, x = page.evaluate(
        "['.track', '.track', '.cursor'].map((name, k) => "
        "Number(document.querySelector(`.octo-chart ${name}`).getAttribute(['x', 'width', "
        "'x1'][k])))"
    )
    return float((x - left) / width * page.evaluate("octoPlayer.end"))


def press(page: Page, key: str) -> None:
    text = {"text": key} if len(key) == 1 else {}
    page.call("Input.dispatchKeyEvent", type="keyDown", key=key, **text)
    page.call("Input.dispatchKeyEvent", type="keyUp", key=key)


def click(page: Page, selector: str, share: float = 0.5) -> None:
    """In the middle of an element's height, at ``share`` of its width."""
    x, y = page.evaluate(
        f"(() => {{ const box = document.querySelector('{selector}').getBoundingClientRect();"
        f"return [box.left + {share} * box.width, box.top + 0.5 * box.height] }})()"
    )
    page.click(x, y)


def picture(page: Page) -> np.ndarray:
    """The scene once it stands still, without viser's notice that there is no graphics card."""
    page.evaluate(
        "document.querySelectorAll('.mantine-Notification-closeButton').forEach(b => b.click())"
    )
    top, bottom = page.evaluate(
        "(() => { const box = document.querySelector('#root').getBoundingClientRect();"
        "return [box.top, box.bottom].map(Math.round) })()"
    )
    last = np.zeros(0)
    for _ in range(40):
        image = np.asarray(imread(io.BytesIO(page.picture())))[top:bottom]
        if image.shape == last.shape and np.array_equal(image, last):
            break
        last = image
        time.sleep(0.3)
    return image


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels that are not the same."""
    return float(np.mean(np.abs(one - other).max(axis=-1) > 0.1))


def test_it_plays_offline_without_errors(tmp_path: Path) -> None:
    with opened(motions.wandering(CHARACTERS["mammal"](), STEPS, DT), tmp_path) as page:
        page.wait_for("octoPlayer.time > 0.2")  # it plays from the start
        pictures = []
        for share in (0.1, 0.6, 0.1):
            click(page, ".octo-chart .track", share)
            assert shown(page) == pytest.approx(share * STEPS * DT, abs=0.02)
            assert cursor(page) == pytest.approx(shown(page), abs=0.002)
            pictures.append(picture(page))
        early, late, again = pictures
        assert early.std() > 0.02, "nothing is drawn"
        assert changed(early, late) > 0.01, "two moments look the same"
        assert changed(early, again) < 0.02 * changed(early, late), (
            "one moment does not look the same twice"
        )
        assert (
            len(
                page.evaluate(
                    "[...document.querySelectorAll('path.curve')].map(c => c.dataset.joint)"
                )
            )
            == 12
        )
        feet = page.evaluate(
            "[...document.querySelectorAll('rect.loaded')].map(bar => bar.dataset.foot)"
        )
        assert set(feet) >= {"front_left", "front_right", "hind_left", "hind_right"}


def test_frames_and_speeds(tmp_path: Path) -> None:
    with opened(motions.wandering(CHARACTERS["mammal"](), STEPS, DT), tmp_path) as page:
        press(page, "Home")
        for key, frame in (
            (".", 1),
            ("ArrowRight", 2),
            (",", 1),
            ("ArrowLeft", 0),
            ("End", STEPS),
            ("Home", 0),
            (".", 1),
        ):
            press(page, key)
            assert shown(page) == pytest.approx(frame * DT, abs=1e-3), key
            assert cursor(page) == pytest.approx(frame * DT, abs=1e-3), key
        click(page, "[data-octo=buttons] button:last-child")
        assert shown(page) == pytest.approx(2 * DT) and page.evaluate("octoPlayer.playing") is False
        click(page, '[data-speed="0.05"]')
        assert (
            page.evaluate(
                "document.querySelector('[data-speed=\"0.05\"]').getAttribute('aria-pressed')"
            )
            == "true"
        )
        began = time.monotonic()
        press(page, " ")
        time.sleep(1.0)
        press(page, " ")
        later = shown(page)
        assert 0.0 < later - 2 * DT <= 0.05 * (time.monotonic() - began) + 1e-3
        time.sleep(0.3)
        assert shown(page) == later  # it stands
        speeds = page.evaluate(
            "[...document.querySelectorAll('[data-speed]')].map(b => Number(b.dataset.speed))"
        )
        assert speeds == [0.05, 0.1, 0.25, 0.5, 1, 2]


@pytest.mark.slow
def test_a_cycle_goes_on_without_a_seam(tmp_path: Path) -> None:
    steps = 60
    walk = motions.wandering(CHARACTERS["mammal"](), steps, dt=2.0 * np.pi / 4.0 / steps)
    # only poses are periodic
    still = dataclasses.replace(walk, contact_force=np.zeros_like(walk.contact_force))
    with opened(still, tmp_path, loop=True) as page:
        page.wait_for("octoPlayer.lap >= 1")
        lap = page.evaluate("octoPlayer.seek(octoPlayer.end); octoPlayer.lap")
        before = picture(page)
        page.evaluate("octoPlayer.play(true)")
        page.wait_for(f"octoPlayer.lap === {lap + 1}")
        page.evaluate("octoPlayer.seek(0)")
        after = picture(page)
        page.evaluate("octoPlayer.seek(0.5 * octoPlayer.end)")
        assert changed(before, after) < 0.02 * changed(before, picture(page))


@pytest.mark.slow
def test_a_soft_body_bends_on_the_page(tmp_path: Path) -> None:
    """Its vertices are those of the modes, between two frames too; the picture changes."""
    motion = motions.swinging()
    assert motion.soft is not None
    with opened(motion, tmp_path) as page:
        seen = []
        for frame, share in ((5, 0.0), (15, 0.5)):
            page.evaluate(f"octoPlayer.seek({(frame + share) * motion.dt})")
            seen.append(picture(page))  # once it stands still
            found = page.evaluate(
                "Array.from(window.__viserMutable.nodeRefFromName["
                "octoPlayer.data.characters[0].bent.names[0]].getObjectByProperty('isMesh', true)"
                ".geometry.attributes.position.array)"
            )
            z = (1.0 - share) * motion.x[frame + 1, 6:] + share * motion.x[frame + 2, 6:]
            wanted = motion.soft.body.deformed(z)
            np.testing.assert_allclose(np.reshape(found, (-1, 3)), wanted, atol=2e-4)
        assert changed(*seen) > 0.01
        bars = page.evaluate(
            "[...document.querySelectorAll('rect.loaded')].map(bar => bar.dataset.foot)"
        )
        assert set(bars) == {"surface"}

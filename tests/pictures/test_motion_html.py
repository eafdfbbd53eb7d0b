"""motion.html in a browser that cannot reach the network."""

from __future__ import annotations

import io
import time
from pathlib import Path

import motions
import numpy as np
import pytest
from chromium import Page, executable, offline_page
from matplotlib.image import imread

from octo.model.gallery import CHARACTERS
from octo.viewer import HOLD, view

SLIDER = "document.querySelector('.mantine-Slider-root')"
STEPS, DT = 120, 0.025
SECONDS = STEPS * DT + HOLD


def shown(page: Page) -> float:
    """s, what the time line says."""
    return float(page.evaluate("document.querySelector('input').value"))


def at(page: Page, share: float) -> np.ndarray:
    """The drawing, with the time line set to ``share`` of its length."""
    left, top, width, height = page.evaluate(
        f"(() => {{ const r = {SLIDER}.getBoundingClientRect(); return [r.left, r.top, r.width, r.height] }})()"
    )
    end = time.monotonic() + 90.0
    while time.monotonic() < end:  # while the page still starts, a click may be lost or the time run on after it
        page.click(left + share * width, top + 0.5 * height)
        image = settled(page, int(top))
        if abs(shown(page) - share * SECONDS) < 0.1:
            return image
    raise AssertionError(f"the time line shows {shown(page)} s, not {share * SECONDS:.1f}")


def settled(page: Page, bottom: int) -> np.ndarray:
    """The drawing above the time line once it stands still, without viser's notice that there is no graphics card."""
    page.evaluate("document.querySelectorAll('.mantine-Notification-closeButton').forEach(button => button.click())")
    last = np.zeros(0)
    for _ in range(40):
        image = np.asarray(imread(io.BytesIO(page.picture())))[: bottom - 10]
        if image.shape == last.shape and np.array_equal(image, last):
            break
        last = image
        time.sleep(0.3)
    return image


def changed(one: np.ndarray, other: np.ndarray) -> float:
    """Share of the pixels that are not the same."""
    return float(np.mean(np.abs(one - other).max(axis=-1) > 0.1))


@pytest.mark.skipif(executable() is None, reason="no chromium or google-chrome is installed")
def test_it_plays_offline_without_errors(tmp_path: Path) -> None:
    file = tmp_path / "motion.html"
    view(motions.wandering(CHARACTERS["mammal"](), STEPS, DT), file)
    program = executable()
    assert program is not None
    with offline_page(program, tmp_path / "profile") as page:
        page.call("Page.navigate", url=f"{file.as_uri()}?fixedDpr=1")
        page.wait_for(f"{SLIDER} !== null && document.querySelector('canvas') !== null")
        at(page, 0.3)
        early, late, again = at(page, 0.1), at(page, 0.6), at(page, 0.1)
        assert early.std() > 0.02, "nothing is drawn"
        assert changed(early, late) > 0.01, "two moments look the same"
        assert changed(early, again) < 0.02 * changed(early, late), "one moment does not look the same twice"
        assert page.errors == []
        outside = [url for url in page.requests if not url.startswith(("file:", "data:", "blob:"))]
        assert outside == []

"""The report in a real browser: no error, and everything leads to its frame of the video."""

import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from made_runs import DT_S, WARNED_FROM, made_run
from playwright.sync_api import Browser, Page, sync_playwright

import ttcvid

PROGRAMS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable")


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """Chromium without a window; TTCVID_CHROMIUM names one that is not on the path."""
    found = os.environ.get("TTCVID_CHROMIUM") or next(filter(None, map(shutil.which, PROGRAMS)), None)
    if found is None:
        pytest.skip("no Chromium found: install the package chromium, or set TTCVID_CHROMIUM to its program")
    with sync_playwright() as playwright:
        # Who is root in a container has no sandbox; the pages are our own.
        browser = playwright.chromium.launch(executable_path=found, args=["--no-sandbox"])
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def report(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run with a video and one warning."""
    return ttcvid.report(made_run(tmp_path_factory.mktemp("report") / "run", has_video=True))


def opened(browser: Browser, page: Path, **context: object) -> tuple[Page, list[str]]:
    """The page, its video ready, and the list to which its errors go."""
    tab = browser.new_context(**context).new_page()
    errors: list[str] = []
    tab.on("console", lambda message: errors.append(message.text) if message.type in ("error", "warning") else None)
    tab.on("pageerror", lambda error: errors.append(str(error)))
    tab.on("request", lambda request: None if request.url.startswith("file:") else errors.append(request.url))
    tab.goto(page.resolve().as_uri())
    wait_until(tab, "[...document.querySelectorAll('video')].every((video) => video.readyState > 1)")
    return tab, errors


def wait_until(tab: Page, condition: str) -> None:
    """Wait until a condition holds, asked from outside: the page's own policy forbids to evaluate text inside."""
    for _ in range(300):
        if tab.evaluate(condition):
            return
        tab.wait_for_timeout(50)
    pytest.fail(f"did not come true in 15 s: {condition}")


def place(tab: Page) -> str:
    return tab.inner_text(".now .place")


def video_s(tab: Page) -> float:
    wait_until(tab, "!document.querySelector('video').seeking")
    return float(tab.evaluate("document.querySelector('video').currentTime"))


@pytest.mark.slow
def test_warnings_plots_directions_and_keys_lead_to_their_frame(browser: Browser, report: Path) -> None:
    tab, errors = opened(browser, report)
    tab.click("button.warning")
    assert place(tab) == f"Frame {WARNED_FROM}, {WARNED_FROM * DT_S:.2f} s"
    assert WARNED_FROM * DT_S < video_s(tab) < (WARNED_FROM + 1) * DT_S
    assert "object 1: 2.50 s (2.25 to 3.00)" in tab.inner_text(".now .what")
    assert "object 2: 2.50 s (more than 2.25)" in tab.inner_text(".now .what")
    tab.focus("h1 + button")
    tab.keyboard.press("ArrowLeft")
    assert place(tab).startswith(f"Frame {WARNED_FROM - 1},")
    tab.keyboard.press("n")
    tab.keyboard.press("Shift+ArrowRight")
    assert place(tab).startswith(f"Frame {WARNED_FROM + 10},")
    tab.locator("figure[data-plot=times]").first.scroll_into_view_if_needed()
    plot = tab.locator("figure[data-plot=times] .u-over").first
    width = plot.bounding_box()["width"]  # type: ignore[index]
    plot.click(position={"x": width / 2, "y": 20})
    assert place(tab).startswith(("Frame 19,", "Frame 20,"))
    tab.locator(".timeline .track").first.click(position={"x": 1, "y": 10})
    assert place(tab).startswith("Frame 0,")
    assert video_s(tab) < DT_S
    tab.locator(".sphere svg circle").last.click()
    assert place(tab).startswith("Frame 0,")
    assert errors == []


@pytest.mark.slow
def test_runs_side_by_side_go_to_the_same_time(browser: Browser, tmp_path: Path) -> None:
    one = made_run(tmp_path / "one", has_video=True)
    other = made_run(tmp_path / "other", 30, has_video=True)
    tab, errors = opened(browser, ttcvid.report(one, other, out=tmp_path / "both.html"))
    tab.locator("button.warning").first.click()
    assert tab.locator(".now .place").all_inner_texts() == [f"Frame {WARNED_FROM}, 2.00 s"] * 2
    tab.uncheck("#together")
    tab.locator(".run").last.locator(".timeline .track").first.click(position={"x": 1, "y": 10})
    assert tab.locator(".now .place").all_inner_texts() == [f"Frame {WARNED_FROM}, 2.00 s", "Frame 0, 0.00 s"]
    assert errors == []


@pytest.mark.slow
def test_the_page_fits_a_phone_and_follows_dark_and_paper(browser: Browser, report: Path, tmp_path: Path) -> None:
    tab, errors = opened(browser, report, viewport={"width": 390, "height": 800}, color_scheme="dark")
    assert tab.evaluate("document.documentElement.scrollWidth") <= 390
    dark = tab.evaluate("getComputedStyle(document.body).backgroundColor")
    tab.click("#theme")
    assert tab.evaluate("getComputedStyle(document.body).backgroundColor") == "rgb(255, 255, 255)" != dark
    tab.pdf(path=tmp_path / "report.pdf")
    wait_until(tab, "document.querySelectorAll('figure[data-plot] canvas').length >= 6")
    assert (tmp_path / "report.pdf").stat().st_size > 20_000
    assert errors == []

"""Makes docs/report.png, the upper part of the demo's report in a browser: ``python docs/report_picture.py``.

It needs Chromium and the libraries of development. The demo's pictures are rendered: frames of real recordings are not
ours to give away.
"""

from __future__ import annotations

import io
import shutil
import tempfile
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

from ttcvid.jobs.demo import demo

SHOWN_FRAME = 36
"""The bus fills a tenth of the picture, the lorry is in view, both are one object each."""
WIDTH_PX, HEIGHT_PX = 1100, 1250
LOADING_MS = 3000
PICTURE = Path(__file__).with_name("report.png")


def main() -> None:
    """Render and analyse the demo, and keep what its report shows of one frame."""
    with tempfile.TemporaryDirectory() as folder, sync_playwright() as playwright:
        page = demo(Path(folder) / "demo").run.report
        assert page is not None
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        tab = browser.new_page(viewport={"width": WIDTH_PX, "height": HEIGHT_PX}, color_scheme="light")
        tab.goto(page.as_uri())
        tab.wait_for_timeout(LOADING_MS)
        tab.evaluate(f"views[0].go({SHOWN_FRAME})")
        # The controls of the video cover the picture.
        tab.evaluate("document.querySelector('video').controls = false")
        tab.wait_for_timeout(LOADING_MS)
        picture = Image.open(io.BytesIO(tab.screenshot()))
        browser.close()
    # An octree keeps the rare colours, such as the red of a warning.
    picture.convert("RGB").quantize(256, method=Image.Quantize.FASTOCTREE).save(PICTURE, optimize=True)


if __name__ == "__main__":
    main()

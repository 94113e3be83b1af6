"""Photograph the live page for docs/guide/first_day.md: docs/first_day/NAME.webp.

python tools/first_day.py [--out docs/first_day]

Chromium and `make test-tools` are required.
"""

from __future__ import annotations

import argparse
import io
import sys
from pathlib import Path
from typing import Any

from graph.browser import page_session
from graph.session import Session
from PIL import Image

from plate_bringup import RunOptions
from plate_core import PlateError, piped

WIDTH_PX, QUALITY = 860, 55

DEFOCUS_PX = 2.5
"""Blur of the camera when its lens was turned the wrong way [px]."""

STEADY_S, MEASURED_S = 6.0, 300.0
"""`STEADY_S`: time for which the page receives messages before a picture [s]. `MEASURED_S`: maximum
time until friction is measured [s]. `MEASURED_S` is also the maximum time until the page of a busy
machine shows no alarm."""


def take_pictures(page: Any, graph: Session, out: Path) -> None:
    """Save a picture of the page after each step of the guide."""

    def save(name: str) -> None:
        page.locator("#alarm").wait_for(state="hidden", timeout=1e3 * MEASURED_S)
        image = Image.open(io.BytesIO(page.screenshot(type="png"))).convert("RGB")
        size = WIDTH_PX, round(image.height * WIDTH_PX / image.width)
        path = out / f"{name}.webp"
        image.resize(size, Image.Resampling.LANCZOS).save(path, quality=QUALITY, method=6)
        print(path)

    page.get_by_role("tab", name="Camera").click()
    # The page compares the sharpness with the best value so far. Therefore the page must receive
    # sharp images first.
    page.wait_for_timeout(1e3 * STEADY_S)
    for name, blur in (("focus", DEFOCUS_PX), ("ready", 0.0)):
        graph.observer.set_parameter("simulator", "defocus_px", blur)
        page.wait_for_timeout(1e3 * STEADY_S)
        save(name)
    page.get_by_role("tab", name="Parts").click()
    page.get_by_role("button", name="Measure friction").click()
    page.get_by_role("button", name="Write mu").wait_for(timeout=1e3 * MEASURED_S)
    save("friction")


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--out", type=Path, default=Path("docs/first_day"), help="folder (default: docs/first_day)"
    )
    out = parser.parse_args().out
    out.mkdir(parents=True, exist_ok=True)
    try:
        with page_session(RunOptions(scenario="sort_6", seed=1, view=True)) as (graph, page):
            graph.observer.await_ready()
            graph.observer.set_parameter("simulator", "friction_spread", 0.1)
            take_pictures(page, graph, out)
    except PlateError as error:
        parser.error(str(error))
    return 0


if __name__ == "__main__":
    sys.exit(main())

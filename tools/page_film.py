"""Film the live page while parts are dragged and a path is drawn: docs/results/page.png and .webp.

python tools/page_film.py [--out docs/results]

Chromium and `make test-tools` are required.
"""

from __future__ import annotations

import argparse
import io
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from graph.browser import page_session
from PIL import Image
from record.webp import save_film

from plate_bringup import RunOptions
from plate_core import PlateError, piped

FRAME_S = 0.25
FILM_WIDTH_PX, QUALITY = 720, 40
STILL_S = 9.0
"""Time in the film at which the still picture is taken [s]."""

DRAGS = (
    ("black_1", (0.12, 0.08), 0.5),
    ("grey_3", (-0.2, -0.08), 2.5),
    ("black_4", (0.2, -0.02), 4.5),
)
"""Part, target position [m] and time [s] of each drag."""

PATH = "grey_2", ((0.0, 0.06), (0.08, 0.0), (0.0, -0.06), (-0.08, 0.0), (0.0, 0.06)), 11.0
END_S = 22.0


class Film:
    """Takes screenshots of the page in a browser."""

    def __init__(self, page: Any) -> None:
        self.page, self.began = page, time.monotonic()
        self.frames: list[tuple[float, bytes]] = []

    @property
    def now(self) -> float:
        """Time since the film began [s]."""
        return time.monotonic() - self.began

    def until(self, t: float) -> None:
        """Take a screenshot every `FRAME_S` until the time t [s]."""
        while self.now < t:
            began = time.monotonic()
            self.frames.append((self.now, self.page.screenshot(type="png")))
            time.sleep(max(0.0, FRAME_S - (time.monotonic() - began)))

    def known(self, what: str) -> Any:
        """Return the value of an expression in the page's module bus.js."""
        bus = "const {known} = await import('./bus.js')"
        return self.page.evaluate(f"async () => {{ {bus}; return {what}; }}")

    def drag(self, points: Sequence[Sequence[float]]) -> None:
        """Move the pressed pointer through points on the plate [m]."""
        box, rig = self.page.locator("#plate").bounding_box(), self.known("known.hello.rig")
        scale = min(box["width"] / (rig["length"] + 0.024), box["height"] / (rig["width"] + 0.024))
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        pixels = [(middle[0] + scale * x, middle[1] - scale * y) for x, y in points]
        self.page.mouse.move(*pixels[0])
        self.page.mouse.down()
        for pixel in pixels[1:]:
            self.page.mouse.move(*pixel, steps=8)
            self.frames.append((self.now, self.page.screenshot(type="png")))
        self.page.mouse.up()

    def place(self, name: str) -> tuple[float, float]:
        """Return the position of a part [m]."""
        part = self.known(f"known.parts.parts.find((part) => part.id === '{name}')")
        return part["x"], part["y"]


def record_film(film: Film) -> None:
    """Drag the parts, then draw a path and let a part follow this path. Take screenshots until
    `END_S`."""
    film.page.get_by_label("Drift").check()
    for name, end, start_s in DRAGS:
        film.until(start_s)
        x, y = film.place(name)
        film.drag(
            [
                (x + fraction * (end[0] - x), y + fraction * (end[1] - y))
                for fraction in (0, 0.3, 0.6, 1)
            ]
        )
    name, points, start_s = PATH
    film.until(start_s)
    film.page.get_by_label("Draw a path").check()
    film.drag([film.place(name), *points])
    film.page.get_by_label("Speed").first.fill("40")
    film.page.get_by_role("button", name="Follow").click()
    film.until(END_S)


def write(frames: list[tuple[float, bytes]], out: Path) -> None:
    """Write the still picture and the film."""
    still = next(data for t, data in frames if t >= STILL_S)
    (out / "page.png").write_bytes(still)
    times = [t for t, _ in frames]
    lengths = [
        round(1e3 * (b - a)) for a, b in zip(times, [*times[1:], times[-1] + 1], strict=True)
    ]
    pictures = [Image.open(io.BytesIO(data)) for _, data in frames]
    save_film(pictures, lengths, out / "page.webp", FILM_WIDTH_PX, QUALITY)


@piped()
def main() -> int:
    """Run the command line. Return its exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument(
        "--out", type=Path, default=Path("docs/results"), help="folder (default: docs/results)"
    )
    out = parser.parse_args().out
    try:
        with page_session(RunOptions(scenario="play", seed=1, view=True)) as (_, page):
            film = Film(page)
            record_film(film)
    except PlateError as error:
        parser.error(str(error))
    out.mkdir(parents=True, exist_ok=True)
    write(film.frames, out)
    print(f"{out}/page.png, {out}/page.webp: {len(film.frames)} frames")
    return 0


if __name__ == "__main__":
    sys.exit(main())

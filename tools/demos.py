"""Run the demo of every scenario, and store small pictures of each run in docs/results.

python tools/demos.py [SCENARIO ...]

Each run is `make demo SCENARIO=... ARGS=--lockstep`. In lockstep, simulated time waits for the
results of the real nodes. Therefore a film does not depend on the computer's load. Runs with a
feeder are not in lockstep, because the robot uses real time. A failed run is reported.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

from PIL import Image, ImageSequence
from record.judge import summary
from record.webp import save_film

from plate_core import piped
from plate_core.tasks import FeedTask, load_scenario

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs/results"

PICKS = 30
"""Number of parts that the robot of a feeder takes."""

MAX_S = 600
"""Maximum duration of a demo with its start and its pictures [s]."""

STRIP_PX, FILM_PX = 800, 520
"""Widths of the stored pictures [px]."""

QUALITY, COLOURS = 25, 64
"""WebP quality of a film, and number of colours of a strip."""


@piped()
def main() -> int:
    """Run the command line. Return the number of demos that failed."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    known = sorted(path.stem for path in (ROOT / "config/scenarios").glob("*.yaml"))
    parser.add_argument(
        "scenarios", nargs="*", default=known, metavar="SCENARIO", help="default: all"
    )
    names = parser.parse_args().scenarios
    path = DOCS / "demos.json"
    runs: dict[str, Any] = json.loads(path.read_text("utf-8")) if path.exists() else {}
    failed = 0
    DOCS.mkdir(parents=True, exist_ok=True)
    for number, name in enumerate(names, 1):
        print(f"[{number}/{len(names)}] {name} ... ", end="", flush=True)
        runs[name] = run(name)
        failed += not runs[name]["well"]
        print(runs[name]["outcome"], flush=True)
        ordered = {key: runs[key] for key in sorted(runs)}
        path.write_text(json.dumps(ordered, indent=1) + "\n", encoding="utf-8")
    return failed


def run(name: str) -> dict[str, Any]:
    """Run one demo, store its pictures, and return its result for demos.json."""
    out = ROOT / "out/demos" / name
    feeds = isinstance(load_scenario(name).task, FeedTask)
    args = f"--picks {PICKS}" if feeds else "--lockstep"
    command = ["tools/demo.py", "--scenario", name, *args.split(), "--out", str(out)]
    done = subprocess.run(
        [sys.executable, *command],
        capture_output=True,
        text=True,
        timeout=MAX_S,
        check=False,
        cwd=ROOT,
    )
    facts = {
        "description": load_scenario(name).description,
        "command": f"make demo SCENARIO={name} ARGS=" + (f"'{args}'" if feeds else args),
    }
    result, pictures = out / "result.json", (DOCS / f"{name}.png", DOCS / f"{name}.webp")
    if not result.exists():
        for picture in pictures:
            picture.unlink(missing_ok=True)
        last = (done.stderr or done.stdout).strip().splitlines()[-1:]
        return facts | {"well": False, "outcome": f"Failed: {' '.join(last)}"}
    shrink_strip(out / "strip.png", pictures[0])
    shrink_film(out / "demo.gif", pictures[1])
    outcome = summary(json.loads(result.read_text(encoding="utf-8")))
    return facts | {"well": done.returncode == 0, "outcome": outcome}


def shrink_strip(source: Path, target: Path) -> None:
    """Store a picture strip with fewer pixels and colours."""
    with Image.open(source) as image:
        size = STRIP_PX, round(image.height * STRIP_PX / image.width)
        small = image.convert("RGB").resize(size, Image.Resampling.LANCZOS)
    small.quantize(COLOURS, dither=Image.Dither.NONE).save(target, optimize=True)


def shrink_film(source: Path, target: Path) -> None:
    """Store an animation as WebP, which is smaller than the GIF."""
    with Image.open(source) as film:
        frames = [frame.copy() for frame in ImageSequence.Iterator(film)]
    durations = [frame.info["duration"] for frame in frames]
    save_film(frames, durations, target, FILM_PX, QUALITY)


if __name__ == "__main__":
    sys.exit(main())

"""The live page of a running graph, in a headless Chromium."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from needs import program

from plate_bringup import RunOptions
from plate_core import PlateError

from .session import Session, session

SIZE: Any = {"width": 1366, "height": 768}
"""Size of the browser window [px]."""

LOADED_MS = 3000
"""Time that the page needs to show the graph [ms]."""


@contextmanager
def page_session(options: RunOptions) -> Iterator[tuple[Session, Any]]:
    """Context with a running graph and its live page. Yields the session and Playwright's page.

    Raises
    ------
    PlateError
        If Playwright or Chromium is missing, or the graph does not start.
    """
    try:
        from playwright.sync_api import sync_playwright
    except ImportError:
        raise PlateError("playwright is not installed: make test-tools") from None
    chromium = program("chromium")
    if chromium is None:
        raise PlateError("chromium is not installed: apt install chromium")
    with (
        TemporaryDirectory() as logs,
        session(options, Path(logs), pictures=False) as graph,
        sync_playwright() as playwright,
    ):
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport=SIZE)
        page.goto(graph.page())
        page.wait_for_timeout(LOADED_MS)
        yield graph, page
        browser.close()

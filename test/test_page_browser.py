"""The live page in a browser, with the real graph behind it."""

import re
import signal

import pytest
from needs import program

pytest.importorskip("rclpy")

TIMEOUT_MS = 30_000
LOCKSTEP = True
"""So parts lie where they shall, however late answers are beside busy programs."""

FEW_FRAMES = "window.requestAnimationFrame = (f) => setTimeout(() => f(performance.now()), 100)"
"""The page draws 10 times a second: without a graphics card each picture takes the processor."""

pytestmark = pytest.mark.needs("chromium", "playwright", "axe_playwright_python")


@pytest.fixture(scope="module")
def browser():
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        found = playwright.chromium.launch(
            executable_path=program("chromium"), args=["--no-sandbox"]
        )
        yield found
        found.close()


@pytest.fixture(scope="module")
def opened(browser, url):
    """The page, opened once; its complaints, and whom it has called."""
    page = browser.new_page(viewport={"width": 1366, "height": 768})
    page.set_default_timeout(TIMEOUT_MS)
    page.add_init_script(FEW_FRAMES)
    complaints, called = [], []
    page.on("console", lambda line: complaints.append(line.text) if line.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda request: called.append(request.url))
    page.goto(url)
    return page, complaints, called


@pytest.fixture
def page(opened, url):
    """It, as it is when parts are seen; a test leaves no complaint."""
    page, complaints, called = opened
    wait_for(page, "known.parts?.parts.length > 0 && known.task && known.driver?.state === 'ready'")
    yield page
    reported, complaints[:] = [*complaints], []
    assert reported == []
    assert [each for each in called if not each.startswith((url, "blob:"))] == []


def known(page, what):
    """The page's data: the newest message of a kind, or a part of it."""
    return page.evaluate(
        f"async () => {{ const {{known}} = await import('./bus.js'); return {what}; }}"
    )


def wait_for(page, condition):
    page.evaluate("async () => { window.known = (await import('./bus.js')).known; }")
    try:
        page.wait_for_function(f"() => {condition}")
    except Exception as error:  # of playwright, which is not imported where it is missing
        pytest.fail(f"{error}\n{condition}\nThe page shows:\n{page.inner_text('body')}")


def pixel(page, x, y):
    """Where a place on the plate [m] is on the screen."""
    box = page.locator("#plate").bounding_box()
    rig = known(page, "known.hello.rig")
    scale = min(box["width"] / (rig["length"] + 0.024), box["height"] / (rig["width"] + 0.024))
    return box["x"] + box["width"] / 2 + scale * x, box["y"] + box["height"] / 2 - scale * y


def part(page, name):
    return known(page, f"known.parts.parts.find((part) => part.id === '{name}')")


def drag(page, start, end, steps=12):
    page.mouse.move(*pixel(page, *start))
    page.mouse.down()
    for k in range(1, steps + 1):
        at = [a + (b - a) * k / steps for a, b in zip(start, end, strict=True)]
        page.mouse.move(*pixel(page, *at))
    page.mouse.up()


def enable(page):
    """Call again if the driver replies "call again", as it does for a moment after a stall."""
    for _ in range(10):
        page.get_by_role("button", name="Enable").click()
        again = "document.getElementById('plate-answer').textContent.includes('call again')"
        wait_for(page, f"known.driver.state === 'ready' || {again}")
        if known(page, "known.driver.state") == "ready":
            return
        page.wait_for_timeout(200)
    pytest.fail("the driver goes on refusing")


def near(name, x, y, within=0.002):
    """Of a part; not of one that the newest image does not show."""
    return (
        f"Math.hypot(...(({{x, y}}) => [x - {x}, y - {y}])(known.parts.parts"
        f".find((part) => part.id === '{name}') ?? {{}})) < {within}"
    )


def test_a_target_that_is_dragged_brings_the_part(page):
    page.get_by_label("Drag targets").check()
    start = part(page, "black_2")
    end = (-0.5 * start["x"], -0.5 * start["y"])
    drag(page, (start["x"], start["y"]), end)
    target = "known.targets?.targets.find((target) => target.id === 'black_2')"
    wait_for(page, f"Math.hypot({target}?.x - {end[0]}, {target}?.y - {end[1]}) < 0.002")
    released = known(page, target)
    wait_for(page, near("black_2", released["x"], released["y"]))


def test_a_path_that_is_drawn_is_followed(page):
    page.get_by_label("Draw a path").check()
    start = part(page, "grey_2")
    end = (0.6 * start["x"], 0.4 * start["y"])
    drag(page, (start["x"], start["y"]), end, steps=40)
    follow = page.get_by_role("button", name="Follow")
    assert follow.is_enabled(), page.inner_text("body")
    page.get_by_label("Speed").first.fill("40")
    follow.click()
    wait_for(page, "known.task.task === 'follow' && known.task.state === 'done'")
    wait_for(page, near("grey_2", *end, 0.004))  # a path has a point each 4 mm
    page.get_by_role("tab", name="Task").click()
    figures = page.locator("dl.figures:visible").inner_text()
    assert re.search(r"error, max\s+[0-9.]+ mm", figures), figures
    assert re.search(r"angle error\s+\u2013", figures), figures  # this task has no angles


def test_the_space_bar_stops_and_twice_too(page):
    page.keyboard.press("Space")
    wait_for(page, "known.driver.state === 'stopped'")
    page.keyboard.press("Space")
    assert "Motors" in page.inner_text("header")
    enable(page)


def test_a_refusal_is_shown_next_to_its_request(page):
    page.get_by_role("button", name="Disable").click()
    wait_for(page, "known.driver.state === 'disabled'")
    page.get_by_role("tab", name="Task").click()
    page.get_by_role("button", name="Start").click()
    refusal = page.locator("#panel-Task output").filter(has_text="refused")
    refusal.wait_for()
    assert "driver" in refusal.inner_text()
    enable(page)


def test_a_node_without_messages_is_named(page, graph):
    graph.processes.signal("driver", signal.SIGSTOP)
    try:
        page.locator("#alarm").filter(has_text="No message from driver").wait_for()
        assert "no message" in page.inner_text("#driver-state")
        page.keyboard.press("Space")
        page.locator("#alarm").filter(has_text="Cut the power by hand").wait_for()
    finally:
        graph.processes.signal("driver", signal.SIGCONT)
    wait_for(page, "known.driver.state === 'stopped'")
    enable(page)
    page.locator("#alarm").wait_for(state="hidden")


def test_every_control_works_without_an_error(page):
    """Buttons, boxes, sliders and lists of all panels, except the stop buttons."""
    for tab in page.get_by_role("tab").all():
        if not tab.is_visible():
            continue
        tab.click()
        panel = page.locator("#panels > section:visible")
        for kind in ("input[type=checkbox]", "input[type=range]", "select", "button"):
            for control in panel.locator(kind).all():
                if not (control.is_visible() and control.is_enabled()):
                    continue
                if kind == "select":
                    control.select_option(index=0)
                elif kind == "input[type=range]":
                    control.press("ArrowRight")
                    control.press("ArrowLeft")
                else:
                    control.click()
    page.get_by_role("tab", name="Parts").click()  # friction may be measured now
    end = page.get_by_role("button", name="End", exact=True)
    if end.is_visible():
        end.click()
    wait_for(page, "known.driver.state === 'ready'")
    for box in page.locator("#layers input").all():
        box.click()
    page.keyboard.press("Escape")


COLOURS = {"runOnly": {"type": "rule", "values": ["color-contrast", "link-in-text-block"]}}
SCHEMES = {"light": {}, "dark": COLOURS}
"""Rules by colour scheme: schemes differ in colours alone."""


def test_the_page_is_accessible(page, graph):
    from axe_playwright_python.sync_playwright import Axe

    graph.processes.signal("simulator", signal.SIGSTOP)  # or the page is drawn again and again
    try:
        for tab in page.get_by_role("tab").all():
            if not tab.is_visible():
                continue
            tab.click()
            for scheme, rules in SCHEMES.items():
                page.emulate_media(color_scheme=scheme)
                options = {"resultTypes": ["violations"], **rules}
                found = Axe().run(page, options=options).response["violations"]
                serious = [each for each in found if each["impact"] in ("serious", "critical")]
                assert [each["id"] for each in serious] == [], serious[0]["nodes"][0]["html"]
    finally:
        graph.processes.signal("simulator", signal.SIGCONT)


def test_the_page_fits_one_screen(page):
    for width, height in ((1366, 768), (1920, 1080), (1024, 768)):
        page.set_viewport_size({"width": width, "height": height})
        size = page.evaluate("[document.body.scrollWidth, document.body.scrollHeight]")
        assert size[0] <= width
        assert size[1] <= height

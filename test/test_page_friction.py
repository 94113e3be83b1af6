"""A measurement of friction that is started and ended on the live page, in real time."""

import asyncio

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("tornado")

from page_client import Browser


def test_friction_is_measured_and_that_is_ended(url):
    async def measure():
        browser = await Browser.open(url)
        await browser.until(lambda newest: newest.get("driver", {}).get("state") == "ready")
        refused = await browser.ask("write_friction")
        assert not refused["ok"]
        assert "friction was not measured" in refused["text"]
        assert (await browser.ask("measure_friction", start=True))["ok"]
        await browser.until(lambda newest: "push 2" in newest.get("friction", {}).get("text", ""))
        assert browser.newest["friction"]["state"] == "running"
        assert browser.newest["driver"]["state"] == "calibrating"
        assert (await browser.ask("measure_friction", start=False))["ok"]
        await browser.until(lambda newest: newest["friction"]["state"] == "failed")
        await browser.until(lambda newest: newest["driver"]["state"] == "ready")
        calls = [call["text"] for call in browser.calls]
        assert any("/measure_friction" in text and "start: true" in text for text in calls)
        await browser.close()

    asyncio.run(measure())

"""Graph, in a browser: drawing, and exported files."""

import re
from pathlib import Path

import pytest
from playwright.sync_api import expect

from client.recording.tables import read_csv
from client.rtde import BlockingRTDEClient
from tests.pendant.conftest import eventually

COLORED = """() => {
  const canvas = document.querySelector(".plot");
  const data = canvas.getContext("2d").getImageData(0, 0, canvas.width, canvas.height).data;
  let count = 0;
  for (let i = 0; i < data.length; i += 4)
    if (Math.max(data[i], data[i + 1], data[i + 2]) - Math.min(data[i], data[i + 1], data[i + 2]) > 60) count++;
  return count;
}"""


def download(page, button: str, folder: Path) -> Path:
    with page.expect_download() as download:
        page.get_by_test_id(button).click()
    file = folder / download.value.suggested_filename
    download.value.save_as(file)
    return file


@pytest.mark.long
def test_plot_is_drawn_and_exported(rig, open_page, tmp_path):
    page = open_page("graph")
    page.get_by_test_id("rate_hz").get_by_text("125 Hz").click()
    expect(page.get_by_test_id("collected")).to_contain_text("at 125 Hz")
    eventually(lambda: page.evaluate(COLORED) > 100)
    expected = dict[float, tuple[float, ...]]()
    rig.control.send_script("def move():\n  movej([0.3, -1.2, 0.4, -1, 0.3, 0.3], a=4, v=2)\nend\n")
    with BlockingRTDEClient(rig.host, ["timestamp", "actual_q", "actual_TCP_force"]) as other:
        for _ in range(60):
            state = other.receive()
            expected[state["timestamp"]] = state["actual_q"], state["actual_TCP_force"]

    def recorded() -> dict[float, tuple[float, ...]]:
        states = read_csv(download(page, "csv", tmp_path)).states()
        return {state["timestamp"]: (state["actual_q"], state["actual_TCP_force"]) for state in states}

    eventually(lambda: max(recorded()) >= max(expected))  # the pendant may receive states later than this test
    page.get_by_test_id("graph-pause").click()
    expect(page.get_by_test_id("graph-pause")).to_contain_text("Resume")
    recorded_states = recorded()
    assert len(expected.keys() & recorded_states.keys()) == 60
    assert {time: recorded_states[time] for time in expected} == expected
    picture = download(page, "png", tmp_path)
    assert picture.suffix == ".png"
    assert picture.read_bytes().startswith(b"\x89PNG")
    assert picture.stat().st_size > 5000


@pytest.mark.long
def test_signals_are_searched_and_selected(rig, open_page):
    page = open_page("graph")
    page.get_by_test_id("choose-1").click()
    page.get_by_test_id("signal-search").fill("tool_temperature")
    row = page.locator(".signals tbody tr", has_text="tool_temperature")
    expect(row).to_contain_text("temperature of the tool board")
    expect(page.locator(".signals tbody .q-checkbox")).to_have_count(1)  # until then the table is redrawn
    row.locator(".q-checkbox").click()
    expect(row.locator(".q-checkbox")).to_have_attribute("aria-checked", "true")
    page.get_by_test_id("signals-show").click()
    entry = page.locator(".legend-entry[data-key='tool_temperature']")
    expect(entry).to_contain_text("°C")
    value = entry.locator("b")
    expect(value).to_have_text(re.compile(r"\d"))  # a dash until the first state with this signal
    assert abs(float(value.inner_text()) - rig.state("tool_temperature")) < 0.5
    entry.click()
    expect(entry).to_have_attribute("data-state", "hidden")

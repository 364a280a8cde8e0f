"""The page in a real browser: of a launched run, of a recording, and without its server."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest
from browser import Browser, browser, needs_browser
from order_desks import obeying_plant
from plans_by_hand import plan_of
from replayed_runs import run_in_memory, write
from running import Start
from served import page_of, served

from agents.settings import FleetPlant

pytestmark = [pytest.mark.processes, needs_browser]
CYCLES = 40
NOTHING_OUTSIDE = (
    "return [...document.querySelectorAll('body :not(script)')].filter(one => {"
    " const box = one.getBoundingClientRect();"
    " return box.width && !one.closest('.uplot, svg') && box.right > innerWidth + 1;"
    "}).map(one => one.id || one.tagName)"
)
"""Script: the elements that reach over the right edge of the window."""


@pytest.fixture(scope="module")
def opened(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Browser]:
    with browser(tmp_path_factory.mktemp("browser")) as found:
        yield found


@pytest.fixture
def window(opened: Browser) -> Browser:
    opened.open("about:blank")
    opened.narrow(1280)
    opened.problems()
    return opened


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder with a recorded run of four inverters."""
    write(tmp_path / "run", run_in_memory())
    return tmp_path / "run"


def at(cycle: int) -> str:
    """Script: whether the page stands at a cycle."""
    text = "document.querySelector('#position-text').textContent"
    return f"return {text}.startsWith('cycle {cycle} of')"


def curve(chart: str) -> str:
    """Script: whether the blue line of the delivered power is drawn in a chart."""
    return (
        f"const c = document.querySelector('#{chart} canvas'); if (!c) return false;"
        "const {data} = c.getContext('2d').getImageData(0, 0, c.width, c.height);"
        "return data.some((red, place) => place % 4 == 0 && red < 60 && data[place + 2] > 130)"
    )


def test_a_launched_run_moves_and_stays_when_it_is_over(
    window: Browser, heliarch: Start, plant: str
) -> None:
    run = heliarch("launch", plant, "--pace", "10", "--page")
    window.open(page_of(run))
    window.until("return document.querySelector('#state').textContent == 'running'", "its run")
    assert window.run("return document.querySelectorAll('.inverter').length") == 4
    moved = "return +document.querySelector('#position').value > {}"
    here = int(window.until("return +document.querySelector('#position').value", "a cycle"))
    window.until(moved.format(here + 5), "later cycles")
    window.until(curve("power-chart"), "curves")
    run.process.send_signal(signal.SIGINT)
    window.until("return document.querySelector('#state').textContent == 'interrupted'", "its end")
    window.until(at(run.recorded_cycles() - 1), "the last cycle")
    assert window.run("return document.querySelector('#banner').hidden")
    assert window.problems() == []
    assert run.process.exitcode is None  # It is still looked at.
    window.open("about:blank")
    assert run.wait() == 130, run.error_text()


def test_a_recording_is_played_stepped_and_scrubbed(window: Browser, run: Path) -> None:
    with served(run) as page:
        window.open(page.address)
        window.until(at(CYCLES - 1), "the last cycle")
        window.press("Home")
        window.until(at(0), "the first cycle")
        window.press("ArrowRight")
        window.until(at(1), "the next cycle")
        window.run(
            "const bar = document.querySelector('#position'); bar.value = 20;"
            "bar.dispatchEvent(new Event('input'))"
        )
        window.until(at(20), "the cycle asked for")
        window.press(" ")
        window.until(at(CYCLES - 1), "the end, played")
        window.press("n")
        window.run(
            "document.querySelectorAll('.inverter')[2]"
            ".dispatchEvent(new MouseEvent('click', {bubbles: true}))"
        )
        assert window.text("#node-title") == "c2/c"
        window.until(curve("node-chart"), "the curves of a node")
        for width in (1280, 800, 420):
            window.narrow(width)
            assert window.run(NOTHING_OUTSIDE) == []
        assert window.problems() == []


def test_a_fleet_is_drawn_as_a_whole_and_plant_by_plant(window: Browser, tmp_path: Path) -> None:
    plan = plan_of(
        {"west/c1/a": 100.0, "west/c1/b": 100.0, "east/c1/a": 100.0, "east/c1/b": 100.0},
        cycles=CYCLES,
        plants=tuple(FleetPlant(name=name, export_limit_kw=200.0) for name in ("west", "east")),
        positions_m=((-20e3, 0.0), (-20.2e3, 0.0), (20e3, 0.0), (20.2e3, 100.0)),
    )
    drawn = "return document.querySelectorAll('#map .inverter').length"
    near = (
        "const [a, b, c] = [...document.querySelectorAll('#map .inverter')]"
        ".map(one => one.getBoundingClientRect().x);"
        "return Math.abs(a - b) > Math.abs(a - c) / 10;"
    )
    with served(write(tmp_path / "fleet", run_in_memory(plan), plan)) as page:
        window.open(page.address)
        window.until(at(CYCLES - 1), "the last cycle")
        assert window.run(drawn) == 4
        assert "Delivered by east" in window.text("#figures")
        assert window.run(near), "plants are drawn too far from each other to be seen"
        window.run(
            "const choice = document.querySelector('#plants'); choice.value = 'east';"
            "choice.dispatchEvent(new Event('change'))"
        )
        assert window.run(drawn) == 2
        assert window.problems() == []


def test_charts_show_values_at_the_cursor_and_zoom(window: Browser, run: Path) -> None:
    with served(run) as page:
        window.open(page.address)
        window.until(at(CYCLES - 1), "the last cycle")
        window.until(curve("power-chart"), "curves")
        left, top, width, _ = window.box("#power-chart .u-over")
        window.move(left + width / 2, top + 20)
        window.until("return document.querySelector('#cursor-time').textContent", "a moment")
        other = "return document.querySelector('#node-chart .u-cursor-x').style.transform"
        assert "translate" in str(window.run(other))  # The cursor is in all charts together.
        window.drag(left + width * 0.2, left + width * 0.4, top + 20)
        zoomed = "return !document.querySelector('#windows button').hidden"
        window.until(zoomed, "the zoom")
        window.double_click(left + width / 2, top + 20)
        window.until("return document.querySelector('#windows button').hidden", "all again")
        assert window.run(at(CYCLES - 1))  # A double click goes nowhere.
        window.press(" ")
        window.until("return +document.querySelector('#position').value < 20", "the beginning")
        window.press("?")
        assert window.run("return document.querySelector('#keys').open")
        assert window.problems() == []


def test_a_folder_of_runs_leads_to_each_of_them(window: Browser, run: Path) -> None:
    with served(run.parent, several=True) as page:
        window.open(page.address)
        window.until("return document.querySelector('#rows a')", "the list")
        typed = "const f = document.querySelector('#filter'); f.value = '{}'; f.oninput();"
        count = " return document.querySelectorAll('#rows tr').length"
        assert window.run(typed.format("nothing") + count) == 0
        assert window.run(typed.format("predictive") + count) == 1
        for width in (1280, 800, 420):
            window.narrow(width)
            assert window.run(NOTHING_OUTSIDE) == []
        window.run("document.querySelector('#rows a').click()")
        window.until(at(CYCLES - 1), "the run")
        window.run("document.querySelector('#back').click()")
        window.until("return document.querySelector('#rows a')", "the list again")


def test_an_address_leads_to_its_cycle_and_node_and_says_who_helped(
    window: Browser, run: Path
) -> None:
    with served(run) as page:
        window.open(f"{page.address}#cycle=20&node=c2/d")
        window.until(at(20), "the cycle of the address")
        window.until("return document.querySelector('#node-title').textContent == 'c2/d'", "node")
        assert window.text("#sentence").startswith("12:00:20")
        window.press("ArrowRight")
        window.until(at(21), "the next cycle")
        window.until("return location.hash == '#cycle=21&node=c2/d'", "its address")
        window.press("End")
        window.until("return location.hash == '#node=c2/d'", "an address that follows the run")
        assert window.problems() == []


def test_the_page_goes_on_from_the_cycle_shown_when_its_server_is_back(
    window: Browser, run: Path
) -> None:
    with served(run) as page:
        window.open(f"{page.address}#cycle=5")
        window.until(at(5), "the cycle of the address")
        window.press("ArrowRight")
        window.until(at(6), "the next cycle")
        port = int(page.root.rstrip("/").rpartition(":")[2])
    window.until("return !document.querySelector('#banner').hidden", "the loss of its server")
    with served(run, port=port):
        window.until("return document.querySelector('#banner').hidden", "its server again")
        window.until(at(6), "the cycle that it showed")


def test_the_page_orders_a_power_and_shows_how_the_plant_settles(
    window: Browser, run: Path
) -> None:
    with (
        obeying_plant(run, plan_of({"a": 200.0, "b": 200.0}, cycles=10_000)),
        served(run, orders=True) as page,
    ):
        window.open(page.address)
        window.until(at(CYCLES - 1), "the run")
        assert "the schedule" in window.text("#order-now")
        most = float(window.run("return document.querySelector('#order-power').max"))
        window.run(
            f"const power = document.querySelector('#order-power'); power.value = {most + 1};"
            "document.querySelector('#order-form').requestSubmit()"
        )
        assert window.text("#order-answer") == ""  # More than the plant's rating is not sent.
        window.run(
            "const slider = document.querySelector('#order-slider'); slider.value = 250;"
            "slider.oninput(); document.querySelector('#order-form').requestSubmit()"
        )
        settled = "return document.querySelector('#order-settling').textContent.includes('reached')"
        window.until(settled, "the plant's answer")
        assert window.text("#order-answer").startswith("in force from cycle")
        assert window.problems() == []


def test_two_pages_with_tokens_on_one_host_do_not_lock_each_other_out(
    window: Browser, run: Path
) -> None:
    with served(run, orders=True) as one, served(run, orders=True) as other:
        for page in (one, other, one):
            window.open(page.address)
            window.until(at(CYCLES - 1), "the run")
        window.open(other.root)
        window.until(at(CYCLES - 1), "the run, by its cookie")

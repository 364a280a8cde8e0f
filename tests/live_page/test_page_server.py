"""The page's server: what it answers, to whom, and that a browser costs it little."""

from __future__ import annotations

import re
import socket
import time
import urllib.request
from pathlib import Path
from urllib.error import HTTPError

import pytest
from command_line import refusal
from msgspec.structs import replace
from plans_by_hand import with_changes
from recordings_by_hand import PLAN, whole_run, write_run
from reports_by_hand import summary_of
from served import served

from results.figures import FIGURES
from scenarios.fault_rules import parse_fault

CYCLES = 60


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A folder with a recorded run."""
    folder = tmp_path / "runs" / "one"
    folder.mkdir(parents=True)
    write_run(folder / "run.mcap", whole_run(CYCLES))
    return folder


def test_a_browser_gets_the_plan_and_then_the_state(run: Path) -> None:
    with served(run) as page:
        plan = page.get("plan")
        assert [node["path"] for node in plan["nodes"]] == list(PLAN.tree.nodes)
        last = next(news for news in page.updates() if news["cycle"] == CYCLES - 1)
        assert last["state"] == "interrupted"  # After 60 of 1,000 cycles.
        assert last["frame"]["nodes"]["power"][0] == 239.0


def test_the_series_of_a_node_and_of_the_plant_can_be_asked_for(run: Path) -> None:
    with served(run) as page:
        next(page.updates())
        node = page.get("node?path=c1/b&from=5&to=9")
        assert node["cycle"] == [5, 6, 7, 8, 9]
        assert node["help"] == [20.0] * 5
        assert page.get("window?from=0&to=3")["dispatch"] == [240.0] * 4
        assert page.status("node?path=c9&from=0&to=1") == 404
        assert page.status("window?from=x") == 404
        assert page.status("stream?from=nan") == page.status("stream?from=0&speed=inf") == 404


def test_a_page_waits_for_a_run_that_has_not_begun(tmp_path: Path) -> None:
    with served(tmp_path / "later") as page:
        assert page.get("plan") is None
        assert next(page.updates())["state"] == "waiting"
        (tmp_path / "later").mkdir()
        write_run(tmp_path / "later" / "run.mcap", whole_run(3))
        assert any(news.get("cycle") == 2 for news in page.updates())


def test_nothing_can_be_commanded_and_no_other_site_gets_in(run: Path) -> None:
    with served(run) as page:
        for path in ("", "plan", "window", "node", "stream"):
            assert page.status(path, "POST") == 405
            assert page.status(path, "PUT") == 405
        assert page.status("plan", Host="evil.example") == 400
        assert page.status("static/../server.py") == 404


def test_other_hosts_need_the_token(run: Path) -> None:
    with served(run, address="0.0.0.0") as page:
        port = page.root.rpartition(":")[2].strip("/")
        page.root = f"http://127.0.0.1:{port}/"
        token = page.address.partition("token=")[2]
        assert "not encrypted" in page.printed
        assert page.status("plan") == page.status("plan?token=wrong") == 403
        with urllib.request.urlopen(f"{page.root}?token={token}") as answer:
            cookie = answer.headers["Set-Cookie"].partition(";")[0]
        assert page.status("plan", Cookie=cookie) == 200


def test_the_runs_of_a_folder_are_listed_with_their_figures(run: Path, tmp_path: Path) -> None:
    document = replace(
        summary_of(run, PLAN),
        planned_cycles=1000,
        interrupted=True,
        cycles=CYCLES,
        figures=dict.fromkeys(FIGURES) | {"control-caused": 4.2},
    )
    (run / "summary.json").write_bytes(document.as_json())
    other = tmp_path / "runs" / "rates" / "rate-1"
    other.mkdir(parents=True)
    write_run(other / "run.mcap", whole_run(2))
    with served(tmp_path / "runs", several=True) as page:
        found = page.get("runs")
        rows = {row["name"]: row for row in found["runs"]}
        assert set(rows) == {"one", "rates~rate-1"}
        assert rows["one"]["figures"]["control-caused"] == 4.2
        assert (rows["one"]["inverters"], rows["one"]["rating_kw"]) == (4, 400.0)
        assert rows["one"]["state"].startswith("interrupted")
        assert rows["one"]["scheme"] == "paper"
        assert page.get("run/rates~rate-1/plan")["plant"] == "field"
        assert page.status("run/two/plan") == 404
        assert page.status("run/..~..~one/plan") == 404


def test_a_browser_that_stalls_or_vanishes_does_not_hold_up_others(run: Path) -> None:
    with served(run) as page:
        host, port = page.root.removeprefix("http://").strip("/").split(":")
        stalled = [socket.create_connection((host, int(port))) for _ in range(5)]
        for one in stalled:
            one.sendall(b"GET /stream?from=0&speed=20 HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
        assert next(page.updates())["cycles"] >= 0
        for one in stalled:
            one.close()
        give_up_at = time.monotonic() + 20.0
        while page.server.streams:
            assert time.monotonic() < give_up_at
            time.sleep(0.05)


def test_a_port_in_use_is_refused_in_one_line(run: Path) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = str(taken.getsockname()[1])
        assert port in refusal("view", run, "--page-port", port)


def test_two_runs_of_a_folder_are_compared(tmp_path: Path) -> None:
    faults = parse_fault("kill=c1/a,at=3s"), parse_fault("source=c2/*,loss=20%")
    for name, rules in (("one", ()), ("two", faults)):
        (tmp_path / name).mkdir()
        write_run(tmp_path / name / "run.mcap", whole_run(9), plan=with_changes(PLAN, faults=rules))
    with served(tmp_path, several=True) as page:
        rows = {row["name"]: row for row in page.get("runs")["runs"]}
        assert rows["two"]["faults"] == ["kill=c1/a,at=3s", "source=c2/*,loss=0.2"]
        with urllib.request.urlopen(f"{page.root}compare?a=one&b=two", timeout=60) as answer:
            text = answer.read().decode()
            assert "script-src 'unsafe-inline'" in answer.headers["Content-Security-Policy"]
        assert "source=c2/*,loss=0.2" in text
        assert {"./", "run/one/", "run/two/"} <= set(re.findall('href="([^"#]+)"', text))
        assert page.status("compare?a=one&b=three") == 404


@pytest.mark.parametrize("several", [False, True])
def test_a_run_is_compared_with_no_help(run: Path, several: bool) -> None:
    with served(run.parent if several else run, several=several) as page:
        path = f"{page.root}run/{run.name}/no-help" if several else f"{page.root}no-help"
        with urllib.request.urlopen(path, timeout=60) as answer:
            text = answer.read().decode()
    assert "without help less with help" in text
    assert ("../../" in re.findall('href="([^"#]+)"', text)) is several


def test_runs_that_cannot_be_compared_are_a_page_with_a_way_back(tmp_path: Path) -> None:
    later = with_changes(PLAN, start_time_ns=PLAN.timing.start_time_ns + 10**9)
    for name, plan in (("one", PLAN), ("later", later)):
        (tmp_path / name).mkdir()
        write_run(tmp_path / name / "run.mcap", whole_run(9), plan=plan)
    with served(tmp_path, several=True) as page, pytest.raises(HTTPError) as refused:
        urllib.request.urlopen(f"{page.root}compare?a=one&b=later", timeout=60)
    text = refused.value.read().decode()
    assert (refused.value.code, refused.value.headers.get_content_type()) == (422, "text/html")
    assert "expected the beginning of" in text
    assert {"./", "run/one/", "run/later/"} <= set(re.findall('href="([^"#]+)"', text))


def test_a_bad_number_is_the_browsers_fault_and_an_error_of_ours_is_not(
    run: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*given: object) -> None:
        raise ValueError("a bug")

    monkeypatch.setattr("live_page.sky.clouds", fail)
    with served(run) as page:
        assert page.status("clouds?cycle=soon") == page.status("clouds?cycle=nan") == 404
        assert page.status("clouds?cycle=1") == 500

"""Links over TCP that packets do not get over: no run ends for it, and all hear each other again.

`pytest -m soak -s tests/processes/test_cut_links.py` prints the table of docs/resilience.md.
"""

from __future__ import annotations

import signal
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from pathlib import Path
from threading import Timer
from typing import NamedTuple

import psutil
import pytest
from cut_network import Network, network_of_its_own, over_tcp
from running import Heliarch, Start
from test_launch import summary_of

from agents.plan import RunPlan
from agents.plan_file import load_plan
from bus_schemas.messages import Dispatch, Message, Production
from bus_schemas.signals import Occurrence, Port
from bus_schemas.tree import PLANT, RECORDER
from launch_scripts.simulation import MemoryRun
from recordings.read.reader import RunReader
from scenarios.preparation import RunOptions, prepare
from scenarios.scenario import load_scenario

pytestmark = pytest.mark.processes

BEFORE_S, AFTER_S = 10.0, 25.0
STOPPED_S = 60.0
LEAF = "c1/inv01"


@pytest.fixture
def network() -> Iterator[Network]:
    with network_of_its_own() as found:
        yield found


class Cut(NamedTuple):
    """What is cut, for how long, and how; `is_killed`: the leaf, once its links are cut."""

    what: str
    seconds: float
    cut: Callable[[Network, RunPlan, Heliarch], None]
    is_killed: bool = False


def port_of(agent: str) -> Callable[[Network, RunPlan, Heliarch], None]:
    return lambda network, plan, run: network.cut_port(plan.access.tcp_ports[agent])


def packets(*match: str, target: str = "DROP") -> Callable[[Network, RunPlan, Heliarch], None]:
    return lambda network, plan, run: network.refuse(*match, target=target)


def recorder_from_plant(network: Network, plan: RunPlan, run: Heliarch) -> None:
    network.cut_links(run.process_of(PLANT).pid, plan.access.tcp_ports[RECORDER])


def leaf(network: Network, plan: RunPlan, run: Heliarch) -> None:
    network.cut_links(run.process_of(LEAF).pid)


def lost(share: float) -> Callable[[Network, RunPlan, Heliarch], None]:
    return packets("-m", "statistic", "--mode", "random", "--probability", str(share))


def stop_all(network: Network, plan: RunPlan, run: Heliarch) -> None:
    """Stop all processes of the run; after the time of the cut they go on."""
    everybody = [psutil.Process(run.process.pid), *run.processes()]
    for one in everybody:
        one.suspend()
    Timer(STOPPED_S, lambda: [one.resume() for one in everybody]).start()


CUTS = [
    *(
        Cut("the recorder's port", seconds, port_of(RECORDER))
        for seconds in (4.0, 10.0, 30.0, 90.0)
    ),
    Cut("recorder and plant from each other", 8.0, recorder_from_plant),
    *(Cut("everything", seconds, packets()) for seconds in (5.0, 30.0)),
    Cut("resets in place of packets", 5.0, packets(target="REJECT --reject-with tcp-reset")),
    *(Cut(f"{share:.0%} of all packets", 30.0, lost(share)) for share in (0.1, 0.4)),
    Cut("a leaf, killed then; new links are whole", 30.0, leaf, is_killed=True),
    Cut("port of central", 30.0, port_of("central")),
    Cut("port of c2", 90.0, port_of("c2")),
    Cut("port of the plant", 30.0, port_of(PLANT)),
    Cut("all processes stopped", STOPPED_S, stop_all),
]


class Outcome(NamedTuple):
    """What a cut did.

    heard_s: How long after it ended the first cycle began in which all heard each other.
    later: Cycles after that one in which somebody did not hear something, or the recorder.
    """

    status: int
    restarts: int
    cycles: int
    unrecorded: int
    heard_s: float
    later: int
    over_kw: float
    under_kw: float

    def row(self, cut: Cut) -> str:
        return (
            f"| {cut.what} | {cut.seconds:g} | {self.status} | {self.restarts} | {self.unrecorded} "
            f"| {self.heard_s:.1f} | {self.later} | {self.over_kw:.0f} | {self.under_kw:.0f} |"
        )


def outcome(
    start: Start, network: Network, scenario: str, cut: Cut, words: tuple[str, ...]
) -> Outcome:
    """Run a scenario for as long as a cut takes, with a while before and after it."""
    duration_s = round(BEFORE_S + cut.seconds + AFTER_S)
    words = ("--pace", "1", "--duration", str(duration_s), *words)
    run = start("launch", scenario, *words, network=network.name)
    run.until_running()
    plan = load_plan(run.folder / "plan.json")
    time.sleep(BEFORE_S * 0.8)
    cut.cut(network, plan, run)
    if cut.is_killed:
        run.process_of(LEAF).send_signal(signal.SIGKILL)
        began_ns = time.monotonic_ns()
    time.sleep(cut.seconds)
    network.heal()
    healed_ns = began_ns if cut.is_killed else time.monotonic_ns()
    status = run.process.wait(timeout=AFTER_S + 60.0)
    assert (run.folder / "summary.json").exists(), run.output.read_text() + run.error_text()
    return judged(run, plan, status, healed_ns)


def judged(run: Heliarch, plan: RunPlan, status: int, healed_ns: int) -> Outcome:
    """Compare a run with the same one in memory, without a cut."""
    due = {port for port in plan.wiring.ports if port.signal.occurrence is Occurrence.CYCLE}
    heard: defaultdict[int, set[Port[Message]]] = defaultdict(set)
    power, asked, ready_ns, lacking = {}, {}, {}, set()
    with RunReader(run.folder) as reader:
        for port, message in reader.messages():
            if port in due:
                heard[message.cycle].add(port)
            if message.missing:
                lacking.add(message.cycle)
            if isinstance(message, Production):
                power[message.cycle] = sum(message.inverter_power_kw)
            if isinstance(message, Dispatch):
                asked[message.cycle] = message.power_kw
                ready_ns[message.cycle] = message.ready_time_ns
    cycle_ns = plan.timing.cycle_wall_ns
    start_ns = min(at_ns - cycle * cycle_ns for cycle, at_ns in ready_ns.items())
    cycles = plan.timing.cycles
    unheard = lacking | {cycle for cycle in range(cycles) if heard[cycle] < due}
    healed = max((healed_ns - start_ns) // cycle_ns, 0)
    again = min({*range(healed, cycles)} - unheard, default=cycles)
    without = {}
    options = RunOptions(duration=str(cycles))
    preparation = prepare(load_scenario(plan.plant), options, "without")

    def hear(port: Port[Message], message: Message) -> None:
        if isinstance(message, Production):
            without[message.cycle] = sum(message.inverter_power_kw)

    for _ in MemoryRun(preparation.plan, preparation.profile, hear).cycles():
        pass
    both = [cycle for cycle in power if cycle in asked]
    return Outcome(
        status,
        sum(summary_of(run.folder).restarts.values()),
        len(power),
        sum(heard[cycle] < due for cycle in range(cycles)),
        max(start_ns + again * cycle_ns - healed_ns, 0) / 1e9,
        sum(cycle > again for cycle in unheard),
        max(power[cycle] - max(asked[cycle], without[cycle]) for cycle in both),
        max(min(asked[cycle], without[cycle]) - power[cycle] for cycle in both),
    )


def test_a_controller_that_is_killed_while_its_links_look_whole_is_heard_again_and_so_are_all(
    heliarch: Start, network: Network, plant: str, tmp_path: Path
) -> None:
    words = ("--pace", "5", "--duration", "1h", *over_tcp(plant, tmp_path / "keys"))
    run = heliarch("launch", plant, *words, network=network.name)
    run.until_recorded(5)
    network.cut_links(run.process_of(LEAF).pid)
    run.process_of(LEAF).kill()
    run.until_back(LEAF)  # Its old links are closed once nothing has come over them for 8 s.
    assert run.interrupt() == 130, run.error_text()
    assert summary_of(run.folder).restarts == {LEAF: 1}


@pytest.mark.soak
@pytest.mark.timeout(600)
@pytest.mark.parametrize("cut", CUTS, ids=lambda cut: f"{cut.what}-{cut.seconds:g}")
def test_a_cut_ends_no_run_and_kills_nobody(
    heliarch: Start,
    network: Network,
    cut: Cut,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    found = outcome(heliarch, network, "oahu", cut, over_tcp("oahu", tmp_path / "keys"))
    with capsys.disabled():
        print(found.row(cut))
    assert found.restarts == cut.is_killed
    # Where many packets are lost, TCP waits for long before it sends them again.
    assert found.heard_s < (15.0 if cut.what == "40% of all packets" else 5.0)

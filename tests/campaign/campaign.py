"""A campaign: small plants, many seeds, each with random faults on the virtual clock.

`make campaign SEEDS=1..1000` runs each seed on one of the plants in turn. A seed gives the same
faults and the same run on every machine. One that breaks what a judge checks is shrunk by one pass
over its faults. Exit status 1: something was broken.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from math import inf
from typing import Final, NamedTuple

from faults import AnyFault, Down, OfTests, Stall, Zombie, begin_s, end_s, faults_of
from judges import Violation, violations, worth
from plants import PLANTS, prepared
from run_trace import FaultyRun, Trace

from agents.faults import Freeze, Kill, ProcessFault, incidents
from agents.plan import RunPlan, changed
from bus_schemas.errors import FailureError
from bus_schemas.faults import Disturbance, Partition
from launch_scripts.simulation import RESTART_TAKES_S, MemoryRun, on_the_clock
from sim_plant.profile import Profile

_SETTLED_CYCLES: Final = 10
"""How long a run goes on once it must be as without faults."""

_OLD_REPORTS_S: Final = 3.0
"""How much longer than `hold_cycles` a parent may divide power by old reports."""

_STOPPED_CYCLES: Final = 3
"""So long before and after a process stands still it may leave a cycle unfinished."""


class Broken(NamedTuple):
    """A seed that broke something, and the shortest list of faults found that still does."""

    plant: str
    seed: int
    faults: tuple[AnyFault, ...]
    violations: tuple[Violation, ...]


@cache
def healthy(name: str) -> FaultyRun:
    """Return the run of a plant without faults, by the same clock."""
    plan, profile = on_the_clock(prepared(name).plan), prepared(name).profile
    return FaultyRun(plan, profile, _trace_of(plan, profile, ()), None, (inf, inf), 10**9, {})


def judged_healthy(name: str) -> list[Violation]:
    """Return what a run without faults breaks; it must also be worth what it was."""
    run, worst = healthy(name), PLANTS[name].worst
    found = list(violations(run))
    if not run.trace.ended:
        was = worth(run)
        for field in was._fields:
            got, most = getattr(was, field), getattr(worst, field)
            if (got < most) if field in {"kept", "promised"} else (got > most):
                found.append(Violation("worth", 0, f"{field} {got:.4f}, expected {most:.4f}"))
    return found


def _trace_of(plan: RunPlan, profile: Profile, faults: Sequence[AnyFault]) -> Trace:
    """Return the messages of a run under some faults."""
    trace = Trace()
    # A run without faults goes by the same clock: a rule of no length says so.
    rules = [one for one in faults if not isinstance(one, OfTests)]
    plan = changed(plan, faults={"rules": (*rules, Disturbance(loss=1.0, at=(1e9, 2e9)))})
    run = MemoryRun(plan, profile, trace)
    for one in faults:
        if isinstance(one, OfTests):
            one.plan_in(run)
    try:
        for _ in run.cycles():
            pass
    except FailureError as failure:
        trace.ended = str(failure)
    return trace


def run_under(name: str, faults: Sequence[AnyFault]) -> FaultyRun:
    """Run a plant under some faults, up to when it must have settled."""
    base = healthy(name)
    plan, cycle_s = base.plan, base.plan.timing.cycle_s
    slowest_s = max(map(plan.site.follows_within_s, plan.tree.leaves))
    hold_s = plan.control.hold_cycles * cycle_s
    rules = tuple(one for one in faults if not isinstance(one, OfTests))
    absences = _Absences(plan, faults)
    last_s = max([*map(end_s, faults), *(end for of in absences.away.values() for _, end in of)])
    settled_s = last_s + slowest_s + PLANTS[name].settles_s + hold_s
    last = inf if PLANTS[name].is_whole else settled_s / cycle_s + _SETTLED_CYCLES
    cycles = min(last, plan.timing.cycles)
    plan = changed(plan, timing={"cycles": round(cycles)})
    trace = _trace_of(plan, base.profile, faults)
    # An inverter that hears nothing more obeys for the revert time. If direct controllers live and
    # hear the plant, only parents decide wrongly, on reports that are at most `hold_cycles` old.
    revert_s = max(plan.site.revert_of(leaf).after_s for leaf in plan.tree.leaves)
    spared = all(_spares_inverters(plan, fault) for fault in faults)
    longest_s = hold_s + slowest_s + (_OLD_REPORTS_S if spared else revert_s)
    stopped = {
        agent: [_stopped(begin, end, cycle_s) for begin, end in spans]
        for agent, spans in absences.away.items()
    }
    only_processes = all(isinstance(one, Kill | Freeze | Down) for one in faults)
    return FaultyRun(
        changed(plan, faults={"rules": rules}),
        base.profile,
        trace,
        base,
        (min(map(begin_s, faults)) / cycle_s, settled_s / cycle_s),
        round(longest_s / cycle_s) + plan.control.periods.longest,
        stopped,
        {agent: [int(at / cycle_s) + 1 for at in times] for agent, times in absences.back.items()}
        if only_processes
        else {},
        {
            agent: [range(int(a / cycle_s) + 1, int(min(b, 1e6) / cycle_s)) for a, b in spans]
            for agent, spans in absences.away.items()
        }
        if only_processes
        else {},
        {one.agent for one in faults if isinstance(one, Zombie)},
    )


def _stopped(begin: float, end: float, cycle_s: float) -> range:
    last = 10**9 if end == inf else int(end / cycle_s) + _STOPPED_CYCLES + 1
    return range(int(begin / cycle_s) - _STOPPED_CYCLES, last)


class _Absences:
    """When each process is away, and when it must be back: the restart policy by its document.

    The first return is at once, the next ones after a wait that doubles, and after `most` within
    `within_s` there is none. One that stands still for `frozen_s` is killed.
    """

    def __init__(self, plan: RunPlan, faults: Sequence[AnyFault]) -> None:
        self.away: dict[str, list[tuple[float, float]]] = {}
        self.back: dict[str, list[float]] = {}
        self._policy = plan.supervision.restart
        self._restarted: dict[str, list[float]] = {}
        self._frozen: dict[str, float] = {}
        rules = [one for one in faults if isinstance(one, ProcessFault)]
        happens = incidents(rules, plan.tree, plan.wiring)
        self._due: list[tuple[float, str, str]] = [(i.time_s, i.agent, i.what) for i in happens]
        while self._due:
            self._due.sort()
            self._happen(*self._due.pop(0))
        for agent, times in self.back.items():  # Unless it is away again at once.
            soon, begins = 4.0 * plan.timing.cycle_s, [begin for begin, _ in self.away[agent]]
            self.back[agent] = [t for t in times if not any(t <= b < t + soon for b in begins)]
        for one in faults:
            if isinstance(one, OfTests):
                end = end_s(one) + (0.0 if isinstance(one, Stall) else RESTART_TAKES_S)
                self.away.setdefault(one.agent, []).append((one.at[0], end))

    def _happen(self, at_s: float, agent: str, what: str) -> None:
        is_gone = any(begin <= at_s < end for begin, end in self.away.get(agent, []))
        if what == "kill" and not is_gone:
            self._kill(agent, at_s, self._frozen.pop(agent, at_s))
        elif what == "freeze" and not is_gone and agent not in self._frozen:
            self._frozen[agent] = at_s
            self._due.append((at_s + self._policy.frozen_s, agent, "watch"))
        elif what == "watch" and at_s - self._frozen.get(agent, inf) > 0.99 * self._policy.frozen_s:
            self._kill(agent, at_s, self._frozen.pop(agent))
        elif what == "thaw" and agent in self._frozen:
            self._return(agent, self._frozen.pop(agent), at_s)

    def _kill(self, agent: str, at_s: float, since_s: float) -> None:
        policy, earlier_s = self._policy, self._restarted.setdefault(agent, [])
        recent = sum(at_s - one < policy.within_s for one in earlier_s)
        if recent >= policy.most:
            self.away.setdefault(agent, []).append((since_s, inf))
            return
        earlier_s.append(at_s)
        wait_s = policy.backoff_s * 2.0 ** (recent - 1) if recent else 0.0
        self._return(agent, since_s, at_s + min(wait_s, policy.within_s) + RESTART_TAKES_S)

    def _return(self, agent: str, since_s: float, at_s: float) -> None:
        self.away.setdefault(agent, []).append((since_s, at_s))
        self.back.setdefault(agent, []).append(at_s)


def _spares_inverters(plan: RunPlan, fault: AnyFault) -> bool:
    """Whether a fault leaves direct controllers alone, and all that they and the plant publish."""
    leaves = set(plan.tree.leaves)
    match fault:
        case Kill() | Freeze():
            stopped = incidents((fault,), plan.tree, plan.wiring)
            return leaves.isdisjoint(one.agent for one in stopped)
        case Down() | Zombie():
            return fault.agent not in leaves
        case Partition(between=agents):
            return leaves.isdisjoint(agents) and not any("*" in agent for agent in agents)
    return False


def plant_of(seed: int) -> str:
    return list(PLANTS)[seed % len(PLANTS)]


def run_seed(seed: int, name: str = "") -> Broken | None:
    """Run a seed; shrink it if it breaks something. A negative one has no faults."""
    name = name or plant_of(seed)
    faults = faults_of(healthy(name).plan, seed)
    broken = list(violations(run_under(name, faults)))
    for fault in faults if broken and len(faults) > 1 else ():
        fewer = tuple(other for other in faults if other is not fault)
        its = list(violations(run_under(name, fewer))) if fewer else []
        if any(one.judge == broken[0].judge for one in its):
            faults, broken = fewer, its
    return Broken(name, seed, faults, tuple(broken)) if broken else None


def run_plant(name: str) -> Broken | None:
    """Judge a plant without faults."""
    broken = judged_healthy(name)
    return Broken(name, 0, (), tuple(broken)) if broken else None


def main(seeds: str) -> int:
    first, _, last = seeds.partition("..")
    listed, began_at, status = range(int(first), int(last or first) + 1), time.monotonic(), 0
    with ProcessPoolExecutor(2) as pool:
        runs = [pool.submit(run_plant, name) for name in PLANTS]
        runs += [pool.submit(run_seed, seed) for seed in listed]
        for run in runs:
            broken = run.result()
            if broken is None:
                continue
            status = 1
            print(f"{broken.plant}, seed {broken.seed}: {list(broken.faults)}")
            for one in broken.violations:
                print(f"  {one.judge}, cycle {one.cycle}: {one.text}")
    print(f"{len(listed)} seeds and {len(PLANTS)} plants in {time.monotonic() - began_at:.0f} s")
    return status


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))

"""What forged messages do to `oahu`: every attack by every attacker, with and without keys.

    python benchmarks/attacks.py --only "keys of central"

Each attacker has a run of its own, in real time. One attack after another lasts ATTACK cycles,
followed by as many quiet cycles. A cell has the largest difference [kW] of the plant's power, as it
was recorded, from that of the same run in memory, and whether the run named the messages. The last
rows: inputs that came late, and how much memory [MB] the recorder took.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any, Final, NamedTuple

import msgspec
import numpy as np
import zenoh
from harness import run
from numpy.typing import NDArray

import heliarch
from agents.plan import RunPlan, load_plan
from bus_schemas.codec import encode
from bus_schemas.errors import InputError
from bus_schemas.messages import Run
from bus_schemas.signals import (
    COMMAND,
    DISPATCH,
    IMPP,
    METER,
    PRODUCTION,
    RESIDUAL,
    RUN,
    SETPOINT,
    TELEMETRY,
    Port,
    Signal,
)
from bus_schemas.zenoh_session import KeyFiles, SessionSettings
from recordings.read.run_file import RECORDING_NAME
from recordings.read.series import read_plant_series

DEVICE: Final = "c2/inv07"
START: Final = "12:40"
"""The plant could give twice what is dispatched."""

FIRST: Final = 10
ATTACK: Final = 6
AHEAD: Final = 3
"""Cycles to come for which messages are forged."""


class Attacker(NamedTuple):
    """Who attacks: what it has, and the run that it attacks."""

    name: str
    words: tuple[str, ...] = ()
    agent: str = ""
    folder: str = ""


EXTERNAL: Final = ("--external", DEVICE)
SECURE: Final = ("--secure", "--keys", "own")
ATTACKERS: Final = (
    Attacker("nothing"),
    Attacker("nothing, beside a device", EXTERNAL),
    Attacker("nothing, with keys", SECURE),
    Attacker("keys of another plant", SECURE, DEVICE, "other"),
    *(Attacker(f"keys of {who}", SECURE, who, "own") for who in (DEVICE, "c2", "central", "plant")),
)


class Attack(NamedTuple):
    """What is forged on all keys of a signal: fields, by rating [kW] and cycle, or a payload."""

    name: str
    signal: Signal[Any]
    fields: Callable[[float, int], dict[str, object]] = lambda kw, cycle: {}
    payload: bytes = b""

    def payloads(self, plan: RunPlan, port: Port[Any], cycle: int) -> list[bytes]:
        if self.payload:
            return [self.payload]
        rating_kw = plan.tree.rating_kw(port.node)
        return [
            encode(
                self.signal.type(
                    cycle=ahead,
                    sim_time_ns=plan.timing.sim_time_ns(ahead),
                    source=port.publisher,
                    missing=(),
                    **self.fields(rating_kw, ahead),
                )
            )
            for ahead in range(cycle + 1, cycle + 1 + AHEAD)
        ]


NO_OTHER: Final[dict[str, object]] = {"commitment_kw": 0.0, "regulation_kw": 0.0}
MUCH: Final[dict[str, object]] = {
    **dict.fromkeys(("dispatch_kw", "available_kw", "delivered_kw"), 9e6),
    **dict.fromkeys(("inverter_mpp_kw", "inverter_power_kw"), (9e6 / 17,) * 17),
}

# What lasts comes last: whom a successor has replaced is not heard any more.
ATTACKS: Final = (
    Attack("`command`, alpha 1", COMMAND, lambda kw, _: {"alpha": 1.0, "power_kw": kw}),
    Attack("`command`, alpha 1e-9", COMMAND, lambda kw, _: {"alpha": 1e-9, "power_kw": 1e-9}),
    Attack(
        "`dispatch` of 8 MW",
        DISPATCH,
        lambda kw, _: {"power_kw": kw, "plant_rating_kw": kw, **NO_OTHER},
    ),
    Attack(
        "`setpoint`, ratings",
        SETPOINT,
        lambda kw, _: {"power_kw": kw, "share_kw": kw, "help_given": ()},
    ),
    Attack(
        "`telemetry` of 0",
        TELEMETRY,
        lambda *_: dict.fromkeys(("power_kw", "alpha", "limit_kw"), 0.0),
    ),
    Attack("`impp` of 0", IMPP, lambda *_: {"power_kw": 0.0, "stale_cycles": 0}),
    Attack("`production` of 9 GW", PRODUCTION, lambda *_: MUCH),
    Attack("flood of 60 kB", RESIDUAL, payload=bytes(60_000)),
    Attack("payloads of 50 MB", METER, payload=bytes(50_000_000)),
    Attack(
        "`run`, stop", RUN, lambda *_: {"state": "stop", "start_time_ns": 0, "cycle_wall_ns": 0}
    ),
    Attack(
        "`command` of a successor",
        COMMAND,
        lambda kw, cycle: {"alpha": 1.0, "power_kw": kw, "incarnation": cycle},
    ),
)


def ports_of(plan: RunPlan, attack: Attack) -> list[Port[Any]]:
    return [port for port in plan.wiring.ports if port.signal is attack.signal]


@contextmanager
def sessions_of(attacker: Attacker, plan: RunPlan, keys: Path) -> Iterator[list[zenoh.Session]]:
    """Link an attacker with every agent that listens, as a peer and as a client."""
    own = KeyFiles.of(keys / attacker.folder, attacker.agent) if attacker.agent else None
    further = own.config() if own else {}
    settings = SessionSettings(plan.bus_namespace, [], [], lockstep=False, further=further)
    host = "tls/127.0.0.1" if own else "tcp/127.0.0.1"
    ports = (*plan.access.tcp_ports.values(), *plan.access.agent_ports.values())
    sessions: list[zenoh.Session] = []

    def link(port: int, mode: str) -> None:
        config = replace(settings, connect=[f"{host}:{port}"]).config()
        config.insert_json5("mode", f'"{mode}"')
        config.insert_json5("connect/timeout_ms", "500")
        with suppress(zenoh.ZError):  # A client has no session where it has no link.
            sessions.append(zenoh.open(config))

    with ThreadPoolExecutor(64) as pool:  # Who is not admitted waits for the time-out.
        for port, mode in product(ports, ("peer", "client")):
            pool.submit(link, port, mode)
    try:
        yield sessions
    finally:
        for session in sessions:
            session.close()


def perform(
    plan: RunPlan, sessions: list[zenoh.Session], start_ns: int, alive: Callable[[], bool]
) -> None:
    """Perform all attacks, each in its own cycles."""
    for number, attack in enumerate(ATTACKS):
        first = FIRST + 2 * ATTACK * number
        while alive():
            cycle = (time.monotonic_ns() - start_ns) // plan.timing.cycle_wall_ns
            if cycle >= first + ATTACK:
                break
            if cycle >= first:
                for port in ports_of(plan, attack):
                    payloads = attack.payloads(plan, port, cycle)
                    for session, payload in product(sessions, payloads):
                        session.put(plan.wiring.key(port), payload)
            if not attack.payload:
                time.sleep(0.02)


def attacked(attacker: Attacker, options: argparse.Namespace, folder: Path) -> list[str]:
    """Run the plant under one attacker; return its column of the table."""
    out, summary = folder / "run", folder / "run" / "summary.json"
    words = [*options.launch, "--pace", str(options.rate), *attacker.words, "--out", str(out)]
    with ExitStack() as stack:
        # The plan is written as soon as the run has ports; a device waits for it by itself.
        process = started([str(options.program), *words], options.keys, stack)
        if attacker.words == EXTERNAL:
            example = Path(__file__).parents[1] / "examples" / "direct_controller.py"
            device = [sys.executable, str(example), "--plan", str(out / "plan.json")]
            started([*device, "--node", DEVICE], options.keys, stack)
        start_ns = start_of(out, process)
        plan = load_plan(out / "plan.json")
        with sessions_of(attacker, plan, options.keys) as sessions:
            if time.monotonic_ns() > start_ns + FIRST * plan.timing.cycle_wall_ns:
                raise SystemExit(f"{attacker.name}: linked too late for the first attack")
            perform(plan, sessions, start_ns, lambda: process.poll() is None)
        status = process.wait(60.0)
    document = msgspec.json.decode(summary.read_bytes()) if summary.exists() else None
    return column(plan, out, status, document, options.undisturbed_kw)


def started(command: list[str], folder: Path, stack: ExitStack) -> subprocess.Popen[bytes]:
    """Start a program that ends with the stack."""
    tied = ["setpriv", "--pdeathsig", "KILL", *command]
    process = subprocess.Popen(tied, cwd=folder, stdout=subprocess.DEVNULL)
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process


def start_of(out: Path, process: subprocess.Popen[bytes]) -> int:
    """Return when cycle 0 of a run begins, as soon as that is recorded."""
    while process.poll() is None:
        with suppress(InputError), heliarch.open_run(out) as recording:
            for _, message in recording.messages(RUN):
                assert isinstance(message, Run)
                return message.start_time_ns
        time.sleep(0.2)
    raise SystemExit("the run ended before it began")


def column(
    plan: RunPlan, out: Path, status: int, document: Any, undisturbed_kw: NDArray[np.float64]
) -> list[str]:
    power_kw = read_plant_series(out / RECORDING_NAME).delivered_kw
    beyond_kw = power_kw - undisturbed_kw[: len(power_kw)]
    wrong = {entry["key"] for entry in document["launcher"]["wrong"]} if document else set()
    cells = []
    for number, attack in enumerate(ATTACKS):
        first = FIRST + 2 * ATTACK * number
        part = beyond_kw[first : first + 2 * ATTACK]
        part = part[np.isfinite(part)]
        most = f"{max(part, key=abs):+,.0f}" if len(part) else "no cycle"
        named = wrong.intersection(str(port) for port in ports_of(plan, attack))
        cells.append(f"{most}, named" if named else most)
    if document is None:
        return [*cells, str(status), "-", "-"]
    memory = {each["kind"]: each["resident_mb"] for each in document["processes"]}
    return [
        *cells,
        str(status),
        str(document["missing_inputs"]),
        f"{memory.get('recorder', 0.0):.0f}",
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rate", type=float, default=1.0, help="cycles per second")
    parser.add_argument("--only", action="append", help="an attacker; may be given several times")
    parser.add_argument("--program", type=Path, default=Path(sys.executable).parent / "heliarch")
    options = parser.parse_args()
    chosen = [one for one in ATTACKERS if not options.only or one.name in options.only]
    with tempfile.TemporaryDirectory(prefix="bench-attacks-") as name:
        options.keys = Path(name)
        for keys in ("own", "other"):
            run([str(options.program), "keys", "oahu", "--out", str(options.keys / keys)])
        length = str(FIRST + 2 * ATTACK * len(ATTACKS))
        same = ["--from", START, "--scheme", "paper", "--duration", length]
        options.launch = ["launch", "oahu", *same]
        out = options.keys / "undisturbed"
        heliarch.simulate("oahu", start=START, duration=length, scheme="paper", out=out)
        options.undisturbed_kw = read_plant_series(out / RECORDING_NAME).delivered_kw
        columns = []
        for attacker in chosen:
            sys.stderr.write(f"{attacker.name}\n")
            with tempfile.TemporaryDirectory(prefix="bench-attacks-") as folder:
                columns.append(attacked(attacker, options, Path(folder)))
    names = [attack.name for attack in ATTACKS]
    print("load", ", ".join(f"{value:.1f}" for value in os.getloadavg()))
    print("| kW |", " | ".join(attacker.name for attacker in chosen), "|")
    print("|---" * (len(chosen) + 1) + "|")
    for row, *cells in zip([*names, "exit status", "late inputs", "MB"], *columns, strict=True):
        print("|", " | ".join([row, *cells]), "|")


if __name__ == "__main__":
    main()

"""`heliarch doctor`: whether a run will work on this machine, and what will slow it down."""

from __future__ import annotations

import os
import platform
import resource
import shutil
import socket
import threading
import time
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Final, Literal, NamedTuple, TypeAlias

from bus_schemas.errors import InputError
from launch_scripts.commands.boundary import FAILED, OK
from launch_scripts.commands.output import write_json
from studies.tables import console_for

_PACKAGES: Final = ("heliarch", "eclipse-zenoh", "numpy", "msgspec", "mcap")
_OPTIONAL: Final = {
    "cryptography": "--secure needs it: pip install 'heliarch[keys]'",
    "pymodbus": "real inverters and `inverters` need it: pip install 'heliarch[modbus]'",
}

_CLOCK: Final = Path("/sys/devices/system/clocksource/clocksource0/current_clocksource")
_GOVERNOR: Final = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")

Verdict: TypeAlias = Literal["ok", "slow", "wrong"]


class Finding(NamedTuple):
    """One thing that was checked, how good it is, and what to do about it.

    `verdict` is `ok`, `slow` where it costs time, and `wrong` where a run will not work.
    """

    about: str
    found: str
    verdict: Verdict = "ok"
    advice: str = ""


def _judged(
    about: str, found: str, is_ok: bool, advice: str, otherwise: Verdict = "slow"
) -> Finding:
    """Return a finding that has advice unless all is well."""
    return Finding(about, found) if is_ok else Finding(about, found, otherwise, advice)


def doctor(
    out: Path = Path(),
    json: str | None = None,
) -> int:
    """Check whether a run will work on this machine, what will slow it down, and what to do.

    Exit status 1: a run would not work.

    --out DIR: Folder in which runs will be recorded.
    Example: heliarch doctor
    """
    from rich.table import Table
    from rich.text import Text

    if not out.is_dir():
        raise InputError(f"--out: expected an existing folder, got {out}")
    found = [
        *_processors(),
        *_scheduling(),
        _clock(),
        _wake_up(),
        _loopback(),
        _zenoh(),
        _open_files(),
        _memory(),
        *_versions(),
        _disk(out),
    ]
    write_json([finding._asdict() for finding in found], json)
    rows = Table.grid(padding=(0, 1))
    for finding in found:
        style = {"ok": "green", "slow": "yellow", "wrong": "bold red"}[finding.verdict]
        rows.add_row(finding.about, Text(finding.verdict, style), Text(finding.found))
        if finding.advice:
            rows.add_row("", "", Text(finding.advice, "dim"))
    console = console_for(json)
    console.print(rows, width=min(console.width, 100))
    return FAILED if any(finding.verdict == "wrong" for finding in found) else OK


def _processors() -> Iterator[Finding]:
    cores = len(os.sched_getaffinity(0))
    few = "use 4 or more if you can: the 23 processes of oahu share them"
    yield _judged("processors", f"{cores}", cores >= 4, few)
    load = os.getloadavg()[0]
    busy = "other programs are running: end them before you measure"
    yield _judged("load", f"{load:.1f}", load <= 0.5 * cores, busy)
    if _GOVERNOR.exists():
        governor = _GOVERNOR.read_text(encoding="ascii").strip()
        advice = "run: cpupower frequency-set -g performance"
        yield _judged("frequency", governor, governor in {"performance", "schedutil"}, advice)


def _scheduling() -> Iterator[Finding]:
    from agents.machine import MachineSettings, refusals

    refused = refusals(MachineSettings(priority=20), lockstep=False)
    for refusal in refused:
        about, _, why = refusal.partition(": ")
        yield Finding(about, why, "slow", "matters only for --priority")
    if not refused:
        yield Finding("real time", "SCHED_FIFO is permitted")


def _clock() -> Finding:
    calls = 20_000
    began_ns = time.perf_counter_ns()
    for _ in range(calls):
        time.monotonic_ns()
    each_ns = (time.perf_counter_ns() - began_ns) / calls
    name = _CLOCK.read_text(encoding="ascii").strip() if _CLOCK.exists() else "unknown"
    advice = "boot with clocksource=tsc if the processor has it"
    return _judged("clock", f"{name}, read in {each_ns:.0f} ns", each_ns < 500.0, advice)


def _wake_up() -> Finding:
    """Sleep for 1 ms again and again, in a thread set up like an agent; see how late it wakes."""
    from agents.machine import wake_precisely

    late_us: list[float] = []

    def sleep() -> None:
        wake_precisely()
        for _ in range(200):
            due_ns = time.monotonic_ns() + 1_000_000
            time.sleep(0.001)
            late_us.append((time.monotonic_ns() - due_ns) / 1e3)

    thread = threading.Thread(target=sleep)
    thread.start()
    thread.join()
    late_us.sort()
    text = f"median {late_us[100]:.0f} µs late, 99 of 100 within {late_us[197]:.0f} µs"
    advice = "agents notice deadlines this late: try --priority"
    return _judged("wake-up", text, late_us[197] < 1000.0, advice)


def _loopback() -> Finding:
    """Send a byte to a thread and back over TCP again and again; see how long it takes."""
    trips_us: list[float] = []
    with socket.create_server(("127.0.0.1", 0)) as server:
        near = socket.create_connection(server.getsockname())
        far, _ = server.accept()

    def answer() -> None:
        while byte := far.recv(1):
            far.send(byte)

    thread = threading.Thread(target=answer)
    with near, far:
        thread.start()
        for _ in range(500):
            began_ns = time.monotonic_ns()
            near.send(b".")
            near.recv(1)
            trips_us.append((time.monotonic_ns() - began_ns) / 1e3)
        near.shutdown(socket.SHUT_WR)
        thread.join()
    trips_us.sort()
    text = f"median {trips_us[250]:.0f} µs there and back, 99 of 100 within {trips_us[495]:.0f} µs"
    advice = "a cycle waits for six such hops: end other programs"
    return _judged("loopback", text, trips_us[250] < 200.0, advice)


def _zenoh() -> Finding:
    import psutil
    import zenoh

    from bus_schemas.zenoh_bus import ZENOH_RUNTIME, SessionSettings, open_session

    before = psutil.Process().num_threads()
    try:
        with open_session(SessionSettings("doctor", ["tcp/127.0.0.1:0"], [])):
            threads = psutil.Process().num_threads() - before
    except zenoh.ZError as error:
        advice = "no agent can listen on 127.0.0.1: ip link set lo up, or reinstall eclipse-zenoh"
        return Finding("Zenoh", f"{error}", "wrong", advice)
    text = f"a session has {threads} thread" + "s" * (threads != 1)
    is_tuned = os.environ.get("ZENOH_RUNTIME", ZENOH_RUNTIME) == ZENOH_RUNTIME
    advice = "unset ZENOH_RUNTIME: one worker thread for each agent is fastest"
    return _judged("Zenoh", text, is_tuned, advice)


def _open_files() -> Finding:
    files, _ = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files == resource.RLIM_INFINITY:
        return Finding("open files", "any number")
    # Recorder and plant have a link with each inverter.
    inverters = max(files - 100, 0)
    advice = f"enough for {inverters:,} inverters; ulimit -n 65536 for more"
    otherwise: Verdict = "slow" if inverters > 50 else "wrong"
    return _judged("open files", f"{files:,} at once", files >= 4096, advice, otherwise)


def _memory() -> Finding:
    import psutil

    free_mb = psutil.virtual_memory().available / 1e6
    processes = int(free_mb // 25)
    advice = "a process needs about 25 MB: end other programs, or take a smaller plant"
    text = f"{free_mb:,.0f} MB free, enough for about {processes:,} processes"
    return _judged("memory", text, processes >= 40, advice)


def _versions() -> Iterator[Finding]:
    found = [f"Python {platform.python_version()}"]
    for name in (*_PACKAGES, *_OPTIONAL):
        try:
            found.append(f"{name} {version(name)}")
        except PackageNotFoundError:
            yield Finding(name, "not installed", "ok", _OPTIONAL.get(name, "reinstall heliarch"))
    yield Finding("versions", ", ".join(found))


def _disk(folder: Path) -> Finding:
    free_gb = shutil.disk_usage(folder).free / 1e9
    # 17 inverters take about 6 kB a cycle.
    hours = free_gb * 1e6 / 6.0 / 3600.0
    text = f"{free_gb:,.1f} GB free, about {hours:,.0f} h of 17 inverters at 1 cycle/s"
    advice = "free some, or choose another folder for runs with --out"
    return _judged("disk", text, free_gb >= 0.1, advice, "wrong")

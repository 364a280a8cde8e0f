"""`heliarch doctor`: whether a run will work on this machine, and what will slow it down."""

from __future__ import annotations

import os
import platform
import resource
import shutil
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Annotated, Final, NamedTuple

from cyclopts import Parameter

from agents.process.machine import MachineSettings, refusals
from bus_schemas.errors import InputError
from heliarch.cli.boundary import FAILED, OK
from heliarch.cli.options import FILES, Json
from heliarch.cli.output import Output

_PACKAGES: Final = {
    **dict.fromkeys(("heliarch", "eclipse-zenoh", "numpy", "msgspec", "mcap"), ""),
    "cryptography": "--secure needs it: pip install 'heliarch[keys]'",
    "pymodbus": "real inverters and `inverters` need it: pip install 'heliarch[modbus]'",
}


class Finding(NamedTuple):
    """One thing that was checked, how good it is, and what to do about it.

    `verdict` is `ok`, `slow` where it costs time, and `wrong` where a run will not work.
    """

    about: str
    found: str
    verdict: str = "ok"
    advice: str = ""


def doctor(
    *,
    out: Annotated[Path, Parameter(metavar="DIR", group=FILES)] = Path(),
    json: Json = None,
) -> int:
    """Check whether a run will work on this machine.

    It says what will slow the run down, and what to do.

    Exit status 1: a run would not work.

    Example: `heliarch doctor`

    Parameters
    ----------
    out
        Folder in which runs will be recorded.
    """
    if not out.is_dir():
        raise InputError.of("--out", f"expected an existing folder, got {out}")
    found, output = [*_machine(), _zenoh(), *_limits(out), *_versions()], Output(json)
    output.write([finding._asdict() for finding in found])
    for about, what, verdict, advice in found:
        output.say(f"{about:14} {verdict:6} {what}")
        if advice:
            output.say(f"{'':21} {advice}")
    return FAILED if any(finding.verdict == "wrong" for finding in found) else OK


def _judged(about: str, found: str, is_ok: bool, advice: str, otherwise: str = "slow") -> Finding:
    """Return a finding that has advice unless all is well."""
    return Finding(about, found) if is_ok else Finding(about, found, otherwise, advice)


def _machine() -> Iterator[Finding]:
    cores, load = len(os.sched_getaffinity(0)), os.getloadavg()[0]
    few = "use 4 or more if you can: the 23 processes of oahu share them"
    yield _judged("processors", f"{cores}", cores >= 4, few)
    busy = "other programs are running: end them before you measure"
    yield _judged("load", f"{load:.1f}", load <= 0.5 * cores, busy)
    refused = refusals(MachineSettings(priority=20), lockstep=False)
    found = "; ".join(refused) or "SCHED_FIFO is permitted"
    yield _judged("real time", found, not refused, "matters only for --priority")


def _zenoh() -> Finding:
    import psutil
    import zenoh

    from bus_schemas.zenoh_session import SOCKET, ZENOH_RUNTIME, SessionSettings, open_session
    from launch_scripts.launch import private_folder

    before = psutil.Process().num_threads()
    try:
        with (
            private_folder() as folder,
            open_session(SessionSettings("doctor", [f"{SOCKET}/{folder}/0"], [])),
        ):
            threads = psutil.Process().num_threads() - before
    except zenoh.ZError as error:
        advice = "no agent can listen on a socket: reinstall eclipse-zenoh"
        return Finding("Zenoh", f"{error}", "wrong", advice)
    is_tuned = os.environ.get("ZENOH_RUNTIME", ZENOH_RUNTIME) == ZENOH_RUNTIME
    advice = "unset ZENOH_RUNTIME: one worker thread for each agent is fastest"
    return _judged("Zenoh", f"threads of a session: {threads}", is_tuned, advice)


def _limits(folder: Path) -> Iterator[Finding]:
    import psutil

    _, files = resource.getrlimit(resource.RLIMIT_NOFILE)
    if files == resource.RLIM_INFINITY:
        files = 2**20
    inverters = max(files - 100, 0)  # Recorder and plant have a link with each inverter.
    advice = f"enough for {inverters:,} inverters; ulimit -n 65536 for more"
    verdict = "slow" if inverters > 50 else "wrong"
    yield _judged("open files", f"{files:,} at once", files >= 4096, advice, verdict)
    free_mb = psutil.virtual_memory().available / 1e6
    advice = "a process needs about 25 MB: end other programs, or take a smaller plant"
    yield _judged("memory", f"{free_mb:,.0f} MB free", free_mb >= 1000.0, advice)
    free_gb = shutil.disk_usage(folder).free / 1e9
    text = f"{free_gb:,.1f} GB free; 17 inverters at 1 cycle/s take 0.02 GB an hour"
    advice = "free some, or choose another folder for runs with --out"
    yield _judged("disk", text, free_gb >= 0.1, advice, "wrong")


def _versions() -> Iterator[Finding]:
    yield Finding("Python", platform.python_version())
    for name, advice in _PACKAGES.items():
        try:
            yield Finding(name, version(name))
        except PackageNotFoundError:
            yield Finding(name, "not installed", advice=advice)

"""A namespace of the network, in which a test drops packets between the processes of one run."""

from __future__ import annotations

import os
import re
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from command_line import done
from tools import missing, not_possible

_PROCESS_ID = r".*:(\d+) +.*:(\d+) +users:.*pid={},"


class Network:
    """A namespace with a loopback interface alone."""

    def __init__(self, name: str) -> None:
        self.name = name

    def run(self, *words: str) -> str:
        command = ["ip", "netns", "exec", self.name, *words]
        return subprocess.run(command, check=True, capture_output=True, text=True).stdout

    def refuse(self, *match: str, target: str = "DROP") -> None:
        """Drop packets of TCP, or answer them as `target` says; all, or those that match."""
        self.run("iptables", "-A", "INPUT", "-p", "tcp", *match, "-j", *target.split())

    def cut_port(self, port: int) -> None:
        for end in ("--sport", "--dport"):
            self.refuse(end, str(port))

    def cut_links(self, pid: int, port: int | None = None) -> None:
        """Cut the links of a process that there are, all or those with a port; new ones are whole.

        Links with a port do not come back: whoever wants a new one is kept from it, too.
        """
        found = re.findall(_PROCESS_ID.format(pid), self.run("ss", "-tnpH"))
        for own, other in found:
            if port is None or int(other) == port:
                self.refuse("--sport", own, "--dport", other)
                self.refuse("--sport", other, "--dport", own)
        if port is not None:
            self.refuse("--dport", str(port), "--syn")

    def heal(self) -> None:
        self.run("iptables", "-F")


def over_tcp(scenario: str, folder: Path) -> tuple[str, ...]:
    """Return the options of a run with keys, whose links are all TCP and can be cut."""
    pytest.importorskip("cryptography")
    done("keys", scenario, "--out", str(folder))
    return ("--secure", "--keys", str(folder))


@contextmanager
def network_of_its_own() -> Iterator[Network]:
    """Make a namespace; skip the test, and say why, where that is not possible."""
    needed = missing("ip", "ss", "iptables")
    if os.geteuid() or needed:
        not_possible(f"a network of its own: {needed or 'needs root'}")
    network = Network(f"heliarch-{os.getpid()}-cut")
    try:
        try:
            subprocess.run(["ip", "netns", "add", network.name], check=True, capture_output=True)
            network.run("ip", "link", "set", "lo", "up")
            network.heal()
        except subprocess.CalledProcessError as error:
            not_possible(f"a network of its own: {error.stderr!r}")
        yield network
    finally:
        subprocess.run(["ip", "netns", "delete", network.name], check=False, capture_output=True)

"""Who can say what to whom: sessions of all agents of a run, and of programs that are none.

The sessions are set up as the agents' own are, with and without keys. Each hears all that it is
sent; an intruder links with all that listen, puts a message on each key, and declares each agent's
liveliness token.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, suppress
from functools import partial
from itertools import product
from pathlib import Path

import psutil
import pytest
import zenoh
from plans_by_hand import plan_of, with_changes

from agents.plan import RunPlan
from agents.process.session import session_settings
from agents.settings import FleetPlant
from bus_schemas.errors import InputError
from bus_schemas.signals import CLOCK, ports
from bus_schemas.tcp_ports import reserved_ports
from bus_schemas.tree import OPERATOR, PLANT, RECORDER
from bus_schemas.zenoh_session import KeyFiles, SessionSettings, open_session
from launch_scripts.launch import private_folder
from scenarios.elsewhere import listening
from scenarios.plant_keys import make_keys

PLANTS = (FleetPlant(name="c1", export_limit_kw=100.0), FleetPlant(name="c2", export_limit_kw=50.0))
BARE = with_changes(plan_of({"c1/a": 100.0, "c2/b": 100.0}), plants=PLANTS)
AGENTS = BARE.tree.agents()
PORTS = [port for port in ports(BARE.tree) if port.signal is not CLOCK]
LISTENING = BARE.links.listening
DEVICE = "c2/b"
INTRUDING_S = 1.0
VALID_S = 15.0

Heard = set[tuple[str, str]]
"""Agent and key."""


def alive(agent: str) -> str:
    return BARE.wiring.alive_key(agent).partition("/")[2]


class Team:
    """Sessions of all agents, linked; what they hear of others, each under a name of its own."""

    def __init__(self, plan: RunPlan, stack: ExitStack) -> None:
        self.plan = plan
        self._heard: list[tuple[str, str, bytes]] = []
        self.sessions = {
            agent: [
                stack.enter_context(open_session(one))
                for settings in [session_settings(plan, agent)]
                for one in (settings, settings.devices)
                if one is not None
            ]
            for agent in plan.agents
        }
        for agent, sessions in self.sessions.items():
            for session in sessions:
                self._listen(agent, session)

    def _listen(self, agent: str, session: zenoh.Session) -> None:
        def hear(sample: zenoh.Sample) -> None:
            key = str(sample.key_expr).partition("/")[2]
            self._heard.append((agent, key, sample.payload.to_bytes()))

        remote = zenoh.Locality.REMOTE
        session.declare_subscriber(f"{self.plan.plant}/**", hear, allowed_origin=remote)
        every_token = self.plan.wiring.alive_key("**")
        session.liveliness().declare_subscriber(every_token, partial(self._see_token, agent))

    def _see_token(self, agent: str, sample: zenoh.Sample) -> None:
        """Note a token that comes: nobody but an intruder declares any."""
        if sample.kind == zenoh.SampleKind.PUT:
            key = str(sample.key_expr).partition("/")[2]
            self._heard.append((agent, key, b"intruder"))

    def heard_of(self, name: str) -> Heard:
        """Who has heard what of a sender."""
        return {(agent, key) for agent, key, said in self._heard if said == name.encode()}

    def say(self, session: zenoh.Session, name: str) -> None:
        """Put a message of a sender on each key."""
        for port in PORTS:
            session.put(self.plan.wiring.key(port), name)

    def until_linked(self, without: str = "") -> None:
        """Wait until each agent's messages come through to each that is to hear them."""
        self._heard.clear()
        give_up_at = time.monotonic() + 30.0
        while not all(
            self.is_heard_right(agent, {place for place in self.due(agent) if place[0] != without})
            for agent in self.plan.agents
            if agent != without
        ):
            assert time.monotonic() < give_up_at, "the links never came up"
            for agent, sessions in self.sessions.items():
                for session in sessions:
                    self.say(session, agent)
            time.sleep(0.1)

    def is_heard_right(self, agent: str, due: Heard) -> bool:
        """With keys, rules keep what an agent says from all others; here each asks for all."""
        heard = self.heard_of(agent)
        return heard == due if self.plan.access.keys_folder else heard >= due

    def can_forge(self, agent: str) -> Heard:
        """Who that listens is to hear what of an intruder in an agent's name."""
        tokens = {(peer, alive(agent)) for peer in self.plan.links.peers(agent)}
        return {place for place in self.due(agent) | tokens if place[0] in LISTENING}

    def due(self, agent: str) -> Heard:
        """Who is to hear what of an agent: its keys, their listeners and the recorder."""
        return {
            (listener, str(port))
            for port in PORTS
            if port.publisher == agent
            for listener in {*self.plan.wiring.listeners.get(port, ()), RECORDER} - {agent}
        }

    def intrude(
        self,
        mode: str = "peer",
        keys: KeyFiles | None = None,
    ) -> Heard:
        """Let a program speak that is none of the agents; return who hears what of it."""
        further = {} if keys is None else keys.config()
        with ExitStack() as stack:
            configs = []
            for endpoint in map(self.plan.access.endpoint, self.plan.access.tcp_ports):
                config = SessionSettings(
                    self.plan.bus_namespace, [], [endpoint], further=further
                ).config()
                config.insert_json5("mode", f'"{mode}"')
                config.insert_json5("connect/timeout_ms", "500")
                configs.append(config)
            with ThreadPoolExecutor(len(configs)) as pool:  # Who is not admitted waits in vain.
                opened = [session for session in pool.map(session_of, configs) if session]
            sessions = [stack.enter_context(session) for session in opened]
            tokens = [
                session.liveliness().declare_token(self.plan.wiring.alive_key(agent))
                for agent, session in product((*AGENTS, OPERATOR), sessions)
            ]
            until = time.monotonic() + INTRUDING_S
            while time.monotonic() < until:
                for session in sessions:
                    self.say(session, "intruder")
                time.sleep(0.05)
            del tokens
        found = self.heard_of("intruder")
        self._heard.clear()
        return found


def session_of(config: zenoh.Config) -> zenoh.Session | None:
    """Open a session; a client that is not admitted has none."""
    with suppress(zenoh.ZError):
        return zenoh.open(config)
    return None


def team_of(plan: RunPlan, sockets: str = "") -> Iterator[Team]:
    with ExitStack() as stack:
        tcp_ports = stack.enter_context(reserved_ports(listening(plan)))
        team = Team(with_changes(plan, tcp_ports=tcp_ports, sockets=sockets), stack)
        team.until_linked()
        yield team


@pytest.fixture(scope="module")
def with_a_device() -> Iterator[Team]:
    with private_folder() as sockets:
        yield from team_of(with_changes(BARE, external=(DEVICE,)), sockets)


@pytest.fixture(scope="module")
def keys(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two folders of keys: `own`, and those of another plant."""
    folder = tmp_path_factory.mktemp("keys")
    for name in ("own", "other"):
        make_keys(folder / name, BARE.plant, (*AGENTS, OPERATOR), 1.0, ())
    return folder


@pytest.fixture(scope="module")
def with_keys(keys: Path) -> Iterator[Team]:
    plan = with_changes(BARE, keys_folder=str(keys / "own"), external=(OPERATOR,))
    yield from team_of(plan)


def test_without_keys_and_devices_no_other_user_can_reach_an_agent() -> None:
    """Root can enter every folder, so another user tries, if this is root."""
    with private_folder() as sockets:
        assert Path(sockets).stat().st_mode & 0o777 == 0o700
        for team in team_of(BARE, sockets):
            assert team.plan.access.tcp_ports == {}
            ends = [connection.status for connection in psutil.Process().net_connections("tcp")]
            assert "LISTEN" not in ends
            names = [str(path) for path in Path(sockets).iterdir() if path.is_socket()]
            assert len(names) == len(LISTENING)
            done = subprocess.run(
                [sys.executable, "-c", CONNECT, *names],
                check=False,
                capture_output=True,
                text=True,
            )
            refused = "refused" if os.geteuid() == 0 else "connected"
            assert done.stdout.split() == [refused] * len(names), done.stderr


CONNECT = """
import os, socket, sys
if os.geteuid() == 0:
    os.setgroups([])
    os.setuid(65_534)
for name in sys.argv[1:]:
    try:
        socket.socket(socket.AF_UNIX).connect(name)
        print("connected")
    except PermissionError:
        print("refused")
"""


def test_a_folder_of_sockets_that_others_can_enter_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o755)
    with pytest.raises(InputError, match="alone can enter"):
        session_settings(with_changes(BARE, sockets=str(tmp_path)), PLANT)


@pytest.mark.parametrize(
    ("cycle_ms", "wait_s"), [(0, 0.02), (20, 0.02), (1_000, 0.1), (60_000, 0.5)]
)
def test_a_message_waits_for_a_tenth_of_the_cycle_before_it_is_dropped(
    cycle_ms: int, wait_s: float
) -> None:
    """With 20 ms at one cycle a second, a group of 1,000 lost what came while others worked."""
    ports = dict.fromkeys(AGENTS, 7447)
    plan = with_changes(BARE, cycle_wall_ns=cycle_ms * 1_000_000, tcp_ports=ports)
    assert session_settings(plan, PLANT).wait_s == wait_s


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_beside_a_device_a_stranger_can_say_what_the_device_may_and_is_heard_by_the_recorder(
    with_a_device: Team, mode: str
) -> None:
    everything = {(RECORDER, str(port)) for port in PORTS if port.publisher != RECORDER}
    everything |= with_a_device.can_forge(DEVICE)
    assert with_a_device.intrude(mode) == everything


@pytest.mark.parametrize("mode", ["peer", "client"])
def test_with_keys_nobody_hears_a_stranger_or_an_agent_of_another_plant(
    with_keys: Team, keys: Path, mode: str
) -> None:
    assert with_keys.intrude(mode) == set()
    others = KeyFiles.of(keys / "other", PLANT)
    assert with_keys.intrude(mode, keys=others) == set()


@pytest.mark.parametrize("agent", [RECORDER, PLANT, OPERATOR, "central", "c1/a"])
def test_with_the_keys_of_an_agent_a_program_can_say_what_that_agent_may_and_no_more(
    with_keys: Team, keys: Path, agent: str
) -> None:
    found = with_keys.intrude(keys=KeyFiles.of(keys / "own", agent))
    assert found == with_keys.can_forge(agent)


@pytest.mark.parametrize("agent", ["c1", "c1/a"])
def test_with_the_keys_of_a_plant_nothing_can_be_said_to_another_plant(
    with_keys: Team, keys: Path, agent: str
) -> None:
    found = with_keys.intrude(keys=KeyFiles.of(keys / "own", agent))
    assert found == with_keys.can_forge(agent)
    assert found
    assert not [name for name, _ in found if name.startswith("c2")]


@pytest.mark.soak
def test_a_link_closes_when_a_certificate_expires_and_comes_back_with_a_renewed_one(
    keys: Path, tmp_path: Path
) -> None:
    """Who connects reads its certificate anew for each link, who listens does not."""
    shutil.copytree(keys / "own", tmp_path / "keys")
    renew = partial(make_keys, tmp_path / "keys", BARE.plant, addresses=())
    expires = renew(agents=["c1/a", "c2/b"], days=VALID_S / 86_400)[0].timestamp()
    for team in team_of(with_changes(BARE, keys_folder=str(tmp_path / "keys"))):
        assert time.time() < expires, "the machine is too slow"
        renew(agents=["c1/a"], days=1.0)
        time.sleep(expires + 1.0 - time.time())
        team.until_linked(without="c2/b")
        assert not team.heard_of("c2/b")

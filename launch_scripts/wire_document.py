"""Writes `docs/wire.md`: all that a foreign program needs to take an agent's place on the bus.

    .venv/bin/python -m launch_scripts.wire_document > docs/wire.md

The tables of signals, types and stages and the examples, byte by byte, are read from the table of
signals, the message types, the codec and the agents themselves, so they cannot differ from what
runs. The rules around them are prose: whoever changes one in the code changes it here. A test holds
the file to this module.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any, Final, cast

from msgspec import inspect

from agents.agent import Agent, Stage, Turn
from agents.central import CentralController
from agents.deadlines import Deadlines
from agents.direct import DirectController
from agents.family import Family
from agents.periods import Periods
from agents.supervisor import Supervisor
from bus_schemas.messages import Message
from bus_schemas.signals import HELP, RESIDUAL, SIGNALS
from bus_schemas.tree import ROOT, ControlTree
from launch_scripts.field_notes import field_notes, without_field_notes
from launch_scripts.wire_layout import INVERTER, layout

_TREE: Final = ControlTree((("c1/inv01", 470.0), ("c2/inv05", 470.0), (INVERTER, 470.0)))
_UNITS: Final = {"_kw": "kW", "_ns": "ns"}
_TYPES: Final[dict[type[inspect.Type], str]] = {
    inspect.IntType: "integer",
    inspect.FloatType: "float 64",
    inspect.StrType: "string",
    inspect.BoolType: "boolean",
}


def wire_document() -> str:
    """Return the document as Markdown."""
    parts = (
        _opening(),
        _signal_table(),
        _types(),
        layout(),
        _cycle(),
        _direct_controller(),
        _real_time(),
        _arming(),
        _rules(),
        _wrong_answers(),
    )
    return "\n".join(line for part in parts for line in part)


def _opening() -> Iterator[str]:
    yield from _paragraphs(
        """
# On the wire

What a program in any language must do to take the place of one agent: a direct controller on a
microcontroller, a foreign plant, a real inverter's gateway. Written by `python -m
launch_scripts.wire_document`, which reads signals, types, bytes and stages from the code.

## Joining

    heliarch launch oahu --pace 1 --external c2/inv07 --base-port 7500 --out my-run

leaves `c2/inv07` out and waits for it to appear, 60 s or as long as `--external-timeout` says; once
all are there, they have 30 s to answer the arming rounds. `plant`,
`central` and supervisors can be left out in the same way, several at once; the recorder cannot.
The launcher says where each of them finds the bus, and so does `my-run/plan.json`, which appears
whole or not at all:

| field of `plan.json` | what it is |
|---|---|
| `namespace`, or if that is empty `run_id` | the Zenoh *namespace* of the run |
| `plant` | first part of every key |
| `inverters` | `[path, rating_kw]` of each inverter; the paths make the control tree |
| `tcp_ports` | the port on 127.0.0.1 of each agent that listens |
| `start_time_ns`, `cycle_ns`, `cycles` | simulated time of cycle 0, length and number of cycles |
| `cycle_wall_ns` | length of a cycle on the wall clock; 0 is lockstep |
| `period_cycles` | how often each tier acts, see *Within a cycle* |
| `tier_deadlines_ns` | deadline of each tier, see *Real time*; empty: the shares given there |
| `actuator`, `alpha_min` | what inverters do with a command, and the lowest alpha |
| `external` | the agents that the launcher did not start |
| `scheme` | what the direct controllers' `impp` means, see *What a direct controller works out* |
| `neighbourhoods`, `hold_cycles` | for parents, see *What a parent works out* |
| `late` | `use` or `drop`: what becomes of messages that come too late, see *Real time* |
| `stall_timeout_s` | lockstep: after so long a wait an agent says for what, and the run ends |
| `faults`, `faults_seed` | what Heliarch's agents do to what comes in; a device does nothing |
| `machine` | processors and priorities of the launcher's processes |
| `timezone`, `regulation_capacity_kw`, `ramp_limit_percent_per_min` | for reports, not for agents |

A later version may add fields: pass over those that you do not know.

With `--base-port` the ports are 7500, 7501, ... in the order recorder, plant, central,
supervisors, and the namespace is the plant's name: a device is set up once, for every run.

**Transport.** [Zenoh](https://zenoh.io) 1.x, peer mode, TCP, without multicast and without
gossip. Peers do not relay, so each pair of agents that exchange messages has a link of its own,
and everybody has one with the recorder. Of a pair the one nearer to the top of the list recorder,
plant, central, supervisors, inverters listens, the other connects, and tries again until it
succeeds. So a direct controller listens nowhere and connects to `recorder`, `plant` and its
parent; a plant listens, and connects to `recorder` alone. Two devices of one run link by the same
list: an external supervisor listens on its port of `tcp_ports`, and an external inverter of its
cluster connects there. In Zenoh's configuration, with the ports of the plan:

    mode: "peer", namespace: "oahu",
    listen/endpoints: [], connect/endpoints: ["tcp/127.0.0.1:7500", "tcp/127.0.0.1:7501", ...],
    connect/timeout_ms: -1, connect/exit_on_failure: false,
    scouting/multicast/enabled: false, scouting/gossip/enabled: false

`listen/endpoints` has to be given, also empty: by default a peer listens on a port of its own
choice. Agents listen on 127.0.0.1: a device on
another host reaches them through a forwarder of TCP ports, such as `ssh -L`.

**Namespace.** Set it in Zenoh's configuration (`namespace`), or, where a library has no such
setting, put it before every key: `<namespace>/<plant>/c2/inv07/impp`.

**Liveliness.** Declare a liveliness token on `<plant>/<name>/alive`, once your subscriptions stand.
Names are `plant`, `central`, `recorder` and the paths of the control tree's other nodes, such as
`c2` and `c2/inv07`. No run begins before all tokens are seen. A token that goes away in mid-run is
named with its cycle; in real time the run goes on, and a device that comes back is taken up again
where the run stands.

**Payload.** One msgpack map from field name to value, encoding `application/msgpack`. Publish
reliably; in lockstep with congestion control BLOCK.
"""
    )


def _signal_table() -> Iterator[str]:
    yield "## Signals"
    yield ""
    yield "| key | type | about | published by | heard by | how often | recorded |"
    yield "|---|---|---|---|---|---|---|"
    for signal in SIGNALS:
        node = "" if signal.nodes(_TREE) == (ROOT,) else "<path>/"
        heard = ", ".join(role.value for role in signal.listeners) or "the recorder alone"
        yield (
            f"| `<plant>/{node}{signal.name}` | {signal.type.__name__} | {signal.about.value} "
            f"| {signal.publisher.value} | {heard} | {signal.occurrence.value} "
            f"| {'yes' if signal.logged else 'no'} |"
        )
    yield ""
    yield "*The node itself* is the one whose path stands in the key; the central controller's path"
    yield "is empty, so that its `impp` has the key `<plant>/impp`. The recorder hears everything."
    yield ""


def _types() -> Iterator[str]:
    yield "## Types"
    yield ""
    yield "Every message begins with these fields:"
    yield ""
    meanings = field_notes(Message)
    yield "| field | msgpack type | what it is |"
    yield "|---|---|---|"
    for field in _fields(Message):
        yield f"| `{field.name}` | {_type_name(field.type)} | {meanings[field.name]} |"
    yield ""
    for kind in dict.fromkeys(signal.type for signal in SIGNALS):
        yield f"### {kind.__name__}"
        yield ""
        yield without_field_notes(kind)
        yield ""
        own = [field for field in _fields(kind) if field.name not in Message.__struct_fields__]
        if own:
            yield from _field_table(kind, own)


def _fields(kind: type[Message]) -> tuple[inspect.Field, ...]:
    return cast("inspect.StructType", inspect.type_info(kind)).fields


def _field_table(kind: type[Message], own: Iterable[inspect.Field]) -> Iterator[str]:
    """Yield the table of a kind's own fields, with what its docstring says of each."""
    meanings = field_notes(kind)
    told = any(field.name in meanings for field in own)
    yield "| field | msgpack type | unit |" + (" what it is |" if told else "")
    yield "|---|---|---|" + ("---|" if told else "")
    for field in own:
        unit = next((unit for end, unit in _UNITS.items() if field.name.endswith(end)), "")
        meaning = f" {meanings[field.name]} |" if told else ""
        yield f"| `{field.name}` | {_type_name(field.type)} | {unit} |{meaning}"
    yield ""


def _type_name(kind: inspect.Type) -> str:
    match kind:
        case inspect.LiteralType():
            return "string, one of " + ", ".join(map(str, kind.values))
        case inspect.VarTupleType(item_type=inspect.StructType() as entry):
            inner = ", ".join(f"{field.name}: {_type_name(field.type)}" for field in entry.fields)
            return f"array of arrays [{inner}]"
        case inspect.VarTupleType():
            return f"array of {_type_name(kind.item_type)}"
    return _TYPES[type(kind)]


def _cycle() -> Iterator[str]:
    yield from _paragraphs(
        """
## Within a cycle

The plant begins a cycle: `telemetry` to each inverter, `dispatch` to the central controller. It
ends it when all commands are there, and says what happened: `production`. In between an agent goes
through its stages in their order. A stage closes when all messages of this cycle that it awaits
have come, or, in real time, at its deadline; then the agent publishes, in this order:
"""
    )
    yield "| agent | stage | awaits | and, where announced | publishes | deadline |"
    yield "|---|---|---|---|---|---|"
    for kind, agent in _agents():
        for stage in agent.stages(0):
            awaits = ", ".join(sorted({port.signal.name for port in stage.awaits}))
            announced = ", ".join(sorted({port.signal.name for port in stage.on_need}))
            share = Deadlines(_TREE, 1_000_000).deadline_ns(agent.name, stage.name) / 1e6
            says = ", ".join(_says(agent, stage))
            yield f"| {kind} | {stage.name} | {awaits} | {announced} | {says} | {share:.3f} |"
    yield ""
    yield from _paragraphs(
        """
The plant awaits every `command`, up to 0.900 of the cycle. A deadline is a share of the cycle on
the wall clock, here that of three tiers; see *Real time*.

- A negative `residual` announces a `help` of the same node and cycle: the parent waits for it. A
  residual that is not negative comes without one.
- `period_cycles` has an entry for each tier that has children, the central controller's first. A
  parent gives `request` and `setpoint` in cycles that are a multiple of its tier's entry. In the
  others its children await neither, go on with the last ones, and publish all the same. In arming
  rounds, below 0, every parent acts whatever its period.
- Each key has one message a cycle at most. Of two the first one holds.
- In lockstep nobody has a deadline, and nothing goes on before you have answered. After a few
  seconds without an answer the run ends and names whom it waited for.
"""
    )


def _agents() -> tuple[tuple[str, Agent[Any]], ...]:
    family = Family("c2", ("c2/inv05", INVERTER), (470.0, 470.0), (), 0)
    periods = Periods((1, 1))
    direct = DirectController(INVERTER, 470.0, 0.05, periods, "paper", "fraction")
    plant = Family(ROOT, ("c1", "c2"), (1.0, 1.0), (), 0)
    return (
        ("direct controller", direct),
        ("supervisor", Supervisor(family, periods)),
        ("central controller", CentralController(plant, periods)),
    )


def _says(agent: Agent[Any], stage: Stage) -> Iterator[str]:
    """Yield the signals that a stage publishes: it does so even if nothing has come."""
    turn = Turn(stage.name, 0, 0, (0, 0, agent.name, ()), {})
    _, outputs = agent.step(agent.initial_state(), turn)
    names = dict.fromkeys(port.signal.name for port, _ in outputs if port.signal is not HELP)
    for name in names:
        yield name
        if name == RESIDUAL.name:
            yield "`help` if it is negative"


def _direct_controller() -> Iterator[str]:
    yield from _paragraphs(
        """
### What a direct controller works out

To the last digit, by the paper's rule (`scheme` is `paper`), with the rating from the plan:

- `impp.power_kw` = min(telemetry.power_kw / telemetry.alpha, rating), and `stale_cycles` = 0. A
  measurement that cannot be right (NaN, negative, above 1.05 times the rating, alpha outside
  (0, 1]) or did not come leaves the last value, and `stale_cycles` counts up.
- `residual.power_kw` = IMPP less request; `help.missing_kw` = less the residual, if it is negative.
- `command.alpha` = setpoint / IMPP, at least `alpha_min`; 1 where the setpoint is not below the
  IMPP. `command.power_kw` = alpha times IMPP; the rating where alpha is 1.
- Before the first words of its parent the request is 0 and the setpoint is the rating. A word that
  does not come, or is outside 0 to the rating, leaves the last one.
- Before the first usable measurement the IMPP is 0, with `stale_cycles` counting from 1.

Where `scheme` is `predictive`, Heliarch's own forecast the maximum of the interval that now begins,
rather than state that of the last one (docs/decisions/0006, `agents/control/forecast.py`). To a
parent it is one and the same: it takes an `impp` for what the node can give in this cycle. A device
may state what it knows best, and follow the rule above whatever the scheme.

### What a parent works out

The central controller and supervisors alike, with children in the order of `inverters` and a node's
rating the sum of its inverters'. This is the arithmetic of a cycle in which all answer; order of
sums, what holds after silence and what is lent between turns are, to the last digit, in
`agents/family.py`, `agents/control/request.py` and `agents/control/allocation.py`, and what is a
supervisor's or the central controller's own in `agents/supervisor.py` and `agents/central.py`.

- What is asked: of a supervisor the last usable `request` (before the first 0); of the central
  controller the last usable `dispatch`, held between 0 and the rating (before the first 0). Each
  child's `request` is the part of it that is the child's part of the rating.
- `impp.power_kw` and `residual.power_kw` are the sums of the children's, `stale_cycles` the largest
  of theirs, `help.missing_kw` is less the residual, if it is negative. A report that cannot be
  right (IMPP outside 0 to the rating, residual outside minus the rating to the IMPP) counts as
  silence. For `hold_cycles` cycles a silent child's last report holds; then it has an IMPP of 0,
  and lacks its part of the request.
- The target: the last usable `setpoint` or `dispatch`; before the first the node's rating. A
  child's `share_kw` is its part of the target by rating, its headroom IMPP less share. If the
  target is the sum of all IMPP or more, each child's `power_kw` is its IMPP. Else the needy, those
  with negative headroom, in their order, ask their siblings one by one for what they lack, and each
  gives what is left of its headroom. `power_kw` is the lesser of share and IMPP, plus what the
  child gives. `help_given` lists what it gives, the needy first to last, in both cases.
- Siblings are asked in the order of their correlation with the needy, the lowest first, equals in
  the order of the children. `neighbourhoods` has it: for each `node` the `hours`, of which that
  with the last `from_time_ns` up to `sim_time_ns` holds, with `correlation` as rows of a matrix
  over the children. Without an entry all are equal.
"""
    )


def _real_time() -> Iterator[str]:
    yield from _paragraphs(
        """
## Real time

`cycle_wall_ns` above 0: cycle k begins `start_time_ns` + k times `cycle_wall_ns`, on the
CLOCK_MONOTONIC of the launcher's host, which all processes of one host share. `start_time_ns` comes
with `run`. Deadlines count from the beginning of the cycle:

- `tier_deadlines_ns` is empty: with h tiers below the central controller the cycle has 3 h + 2
  places, and place p closes at 0.9 p / (3 h + 2) of it. An agent of level l (central 0, its
  children 1) has `request` at place 1 + l, `report` at 1 + 2 h - l, `solve` at 1 + 2 h + l; a
  direct controller has `estimate` at 1 + l and `actuate` at 1 + 2 h + l; the plant goes on at the
  last place. Above are those of h = 2.
- Otherwise it has an entry for each tier, the central controller's first and the direct
  controllers' last: the time after the tick by which `solve` or `actuate` closes. The central
  one's entry is shared evenly among the places up to its `solve`. The plant goes on halfway
  between the last entry and the next tick.

**A device needs no common clock if it answers on arrival**: telemetry (and request, in the
parent's turns) in, `impp` and `residual` out; `setpoint` in, `command` out. Where something does
not come it answers without, by its own clock, at the deadline of its stage or a little earlier: in
a tree as above, 0.3 of the cycle after its telemetry it no longer waits for the `request`, and 0.75
after it no longer for the `setpoint`. Arming rounds have no deadlines. Without telemetry it does as
in the cycle before, if it has a clock, or is silent. `publish_time_ns` from a foreign clock would
spoil hop latencies and the order of messages in time: such a device sends the `publish_time_ns` of
the message that it answers plus the nanoseconds that the answer took it, or 0, which counts as
unknown.

**After a deadline** an agent goes on without what is missing, and names it in `missing`:

- `c2/inv07/impp`: nothing came on it by the deadline, and nothing took its place.
- `c2/inv07/impp@41`: the late word of cycle 41 was used in its place. If the plan's `late` is
  `use`, Heliarch's agents keep what comes after its stage has closed, the newest of each key, and
  use it once, where this cycle's fails to come in time. They also take up a parent's late `request`
  or `setpoint` in a cycle in which they await none: `c2/setpoint@60` in cycle 70. A device need not
  do so: it may drop what is late, and name the bare key.
- `skipped@41`: the sender had fallen behind, and gave up its cycles from 41 up to the one before
  this. Nothing is sent for them that another agent acts on.

For a parent, a child is silent whose `impp` does not come; what is silent for more than
`hold_cycles` cycles has nothing to give. A `residual` that does not come, or is of another cycle
than the `impp`, it works out itself, from the request that it made. An inverter whose command is
missing keeps its last one. A device may leave `missing` empty, but then its recording does not tell
which inputs an answer used.

**Counts.** Processes publish `timing` and `plant_timing` about themselves; nobody waits for them,
and a device need not send them.
"""
    )


def _arming() -> Iterator[str]:
    yield from _paragraphs(
        """
## Before cycle 0, and the end

Cycles with numbers below 0 are *arming rounds*: whole cycles that prove all links.

**A controller** answers every message of one as in the run, with the cycle number of the message,
`sequence` 0, and beginning each round from its initial state. A round begins with its first message
from above: `telemetry`, `dispatch`, `request` or `setpoint`, and ends the one under way. What a
child says of a round before that is kept or dropped, and begins nothing. Cycle 0 begins with its
first message from above, or with `run` of state `start`, whichever comes first, for they are on
keys of their own; again from the initial state. `run` of state `stop` names the first cycle that
does not take place; what is under way before it is completed, and then the agent leaves. A device
that joins a run under way begins with the first cycle that it hears of.

**A plant** conducts the run:

1. It waits until the liveliness tokens of all other agents are there.
2. It sends rounds of cycle -999,999, -999,998 and so on: `telemetry` to each inverter and
   `dispatch`, under the conditions of cycle 0; awaits every command of that round; answers with
   `production`. A round is closed when all commands are in and the recorder has published `ready`
   with its cycle, which it does once every signal that comes in each cycle has been heard. A round
   that is not closed after some 0.3 s, and later ones after up to 3 s, is given up for the next.
3. `run` of state `start`, cycle 0, `cycle_wall_ns` as in the plan; `start_time_ns` is the monotonic
   time of the first tick, some 0.2 s ahead; in lockstep now. (`sequence` of `run`: 0.)
4. Cycles 0 to `cycles` - 1: at the tick `dispatch` and `telemetry` with what each inverter did in
   the interval before; at the end `production`. Where `actuator` is `fraction` an inverter gives
   alpha times its maximum; where it is `limit` it gives its maximum up to `command.power_kw`.
5. `run` of state `stop`, with the cycle after the last one. (`sequence`: 1.)

The launcher follows an external plant through the recorder. It cannot stop one: on Ctrl-C the
controllers end, and the plant is left to itself.
"""
    )


def _rules() -> Iterator[str]:
    yield from _paragraphs(
        """
## Rules

- `source` is the agent's own name, and only the one that the table of signals names may publish
  on a key.
- `cycle` is that of the messages that the stage used, `sim_time_ns` = `start_time_ns` + `cycle`
  times `cycle_ns` of the plan, also below 0.
- `missing` lists the keys, without the plant's name, of the inputs of this cycle that did not come
  in time, of the stage and those before it. Empty in lockstep.
- `publish_time_ns` is the host's monotonic clock when the message goes out. `sequence` counts the
  messages on the key from 0, from cycle 0 on: from its gaps the recorder tells what was lost. It
  begins anew after a restart.
- Integers have bounds: `cycle` above -2^31 and below 10^18, times [ns] between -2^62 and 2^62,
  those of the host's clock not below 0, counts from 0 to below 2^32, that of a notice below 2^62.
- Texts have bounds too: `source` and paths 200 characters; `missing` 4,096 entries of 256
  characters. No tree has agents that wait for so many messages, nor keys so long.
- Powers are in kW. `impp` lies between 0 and the rating, `residual` between minus the rating and
  the IMPP, `alpha` in (0, 1], `command.power_kw` between 0 and the rating.
"""
    )


def _wrong_answers() -> Iterator[str]:
    yield from _paragraphs(
        """
## Wrong answers

None of them stops anybody else. The recorder, which hears everything, counts what is wrong by key
and cause, and gives an example in its log, on the launcher's screen and in the summary: of absurd
messages one of each field that was wrong. Listeners count what they drop by key and cause too, with
examples in their logs; in the summary the larger count of the two holds. What one agent did wrong
in the same way on several keys is one line on the screen; the JSON has each key.

| what | cause | what becomes of it |
|---|---|---|
| no msgpack, a wrong type, a field too few or too many | `undecodable` | dropped |
| an integer, `source` or `missing` beyond its bounds | `undecodable` | dropped |
| a key of a node or signal that the run does not have | `unknown` | dropped |
| `source` is not who may publish on the key | `foreign` | dropped |
| a cycle that is over | `late` | kept as a late word in real time, else dropped |
| a cycle ahead by more than the longest period, or before the run | `other_cycle` | dropped |
| a second message on a key in a cycle | `duplicate` | dropped: the first one holds |
| the same, and it says something else | `repeated` | dropped as well, but recorded |
| not due in this cycle | `unexpected` | dropped |
| NaN, infinite, beyond the bounds in *Rules* | `absurd` | to listeners it is silence |
| a `dispatch` below 0 or above the rating | none, but a `notice` | held within, and acted on |
| a `sim_time_ns` that is not its cycle's | `absurd` | used: the recorder alone looks at it |
| a `run` that begins over 10 s from now, in real time | `absurd` | it begins now instead |
| a `run` with another `cycle_wall_ns` than the plan | `absurd` | that of the plan holds |
| a second `run` of state `start` | `repeated` | dropped, but recorded |
| nothing | `missing` of those who waited | real time: done without; lockstep: the run ends |
| more than can be looked at | `flooded` | of 10,000 waiting on, 100 of each key are kept |

A program that gives both another's key and another's name is not told from that agent: the first
message in a cycle holds. Who may link with the agents is for Zenoh's access control to say.
"""
    )


def _paragraphs(text: str) -> Iterator[str]:
    yield text.strip("\n")
    yield ""


def main() -> None:
    """Write the document to standard output."""
    sys.stdout.write(wire_document())


if __name__ == "__main__":
    main()

"""Writes `docs/wire.md`: all that a foreign program needs to take an agent's place on the bus.

    .venv/bin/python -m launch_scripts.wire_document > docs/wire.md

The tables of signals, types, stages and bounds and the examples, byte by byte, are read from the
code, so they cannot differ from what runs. The rules around them are prose: whoever changes one in
the code changes it here. A test compares the file with this module.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any, Final, cast

import numpy as np
from msgspec import inspect

from agents.agent import Agent, Stage, Turn
from agents.control.forecast import HIDDEN_ALPHA_MIN
from agents.plan import RunPlan
from agents.team import controllers
from bus_schemas.bounds import BOUNDS, LARGEST, METER_TOLERANCE, Bound
from bus_schemas.messages import Dispatch, Message
from bus_schemas.signals import DISPATCH, HELP, RESIDUAL, SIGNALS
from bus_schemas.tree import CENTRAL, PLANT, ROOT
from launch_scripts.scenarios.field_notes import field_notes, without_field_notes
from launch_scripts.wire_layout import INVERTER, layout
from sim_plant.plant import Plant
from sim_plant.profile import Profile

_PLAN: Final = RunPlan(
    run_id="example",
    plant="oahu",
    inverters=(("c1/inv01", 470.0), ("c2/inv05", 470.0), (INVERTER, 470.0)),
    start_time_ns=0,
    cycle_ns=1_000_000,
    cycles=1,
    timezone="UTC",
    regulation_capacity_kw=0.0,
    cycle_wall_ns=1_000_000,
    period_cycles=(1, 1),
    scheme="paper",
    actuator="fraction",
    alpha_min=0.05,
    hold_cycles=3,
    stall_timeout_s=1.0,
    neighbourhoods=(),
    tcp_ports={},
)
_TREE: Final = _PLAN.tree
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
        _one_rule_for_time(),
        _direct_controller(),
        _parent(),
        _real_time(),
        _arming(),
        _rules(),
        _bounds(),
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

leaves `c2/inv07` out and waits for it to appear, for 60 s or as long as `--external-timeout` says.
Once all agents are there, they have 30 s to answer the arming rounds. `plant`, `central` and
supervisors can be left out in the same way, several at once; the recorder cannot. The launcher
prints where each of them finds the bus, and so does `my-run/plan.json`, which appears whole or not
at all:

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
| `hold_cycles` | an input older than this is silent, see *One rule for time* |
| `external` | the agents that the launcher did not start |
| `scheme` | what the direct controllers' `impp` means, see *What a direct controller works out* |
| `neighbourhoods` | order of help among children, see *What a parent works out* |
| `correction` | whether the central controller corrects its target by the plant's meter |
| `available_bias` | whether simulated inverters state their available power, and its error |
| `stall_timeout_s` | lockstep: after so long a wait an agent says for what, and the run ends |
| `faults`, `faults_seed` | what Heliarch's agents do to what comes in; a device does nothing |
| `machine` | processors and priorities of the launcher's processes |
| `timezone`, `regulation_capacity_kw`, `ramp_limit_percent_per_min` | for reports, not for agents |

A later version may add fields: ignore those that you do not know.

With `--base-port` the ports are 7500, 7501, ... in the order recorder, plant, central,
supervisors, and the namespace is the plant's name. So a device is set up once for all runs.

**Transport.** [Zenoh](https://zenoh.io) 1.x, peer mode, TCP, without multicast and without
gossip. Peers do not relay, so each pair of agents that exchange messages has a link of its own,
and every agent has one with the recorder. Of each pair, the agent nearer to the top of the list
recorder, plant, central, supervisors, inverters listens; the other one connects, and tries again
until it succeeds. So a direct controller does not listen, and connects to `recorder`, `plant` and
its parent. A plant listens, and connects to `recorder` alone. Two devices of one run link by the
same list: an external supervisor listens on its port of `tcp_ports`, and an external inverter of
its cluster connects there. In Zenoh's configuration, with the ports of the plan:

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
`c2` and `c2/inv07`. No run begins before all tokens are seen. If a token goes away during the run,
the launcher names it with its cycle. In real time the run goes on, and a device that comes back
joins it where it stands.

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
    yield "*The node itself* is the one whose path is in the key. The central controller's path is"
    yield "empty, so its `impp` has the key `<plant>/impp`. The recorder hears everything. No agent"
    yield "acts on `help`, `production` or `notice`: they are for people and recordings."
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
        case inspect.UnionType():
            there = [one for one in kind.types if not isinstance(one, inspect.NoneType)]
            return " or ".join(map(_type_name, there)) + ", nil or left out"
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

The plant begins a cycle with the `dispatch`, its `meter` and the `telemetry` of each inverter. It
ends the cycle once it has all commands, and publishes what happened: `production`. In between each
agent goes through its stages. A stage closes when the messages of this cycle that it awaits have
come, or, in real time, at its deadline. The agent then decides on the newest message of each input
that the stage awaits or uses, and publishes:
"""
    )
    yield "| agent | stage | awaits | uses as well | publishes | deadline |"
    yield "|---|---|---|---|---|---|"
    for kind, agent in _agents():
        for stage in agent.stages(0):
            awaits = ", ".join(sorted({port.signal.name for port in stage.awaits}))
            uses = ", ".join(sorted({port.signal.name for port in stage.uses}))
            share = _PLAN.deadlines.deadline_ns(agent.name, stage.name) / _PLAN.cycle_wall_ns
            says = ", ".join(_says(agent, stage))
            deadline = "at the tick" if stage.timed else f"{share:.3f}"
            yield f"| {kind} | {stage.name} | {awaits} | {uses} | {says} | {deadline} |"
    yield ""
    yield from _paragraphs(
        """
A deadline is a share of the cycle on the wall clock, here of a tree with three tiers; see *Real
time*.

- `period_cycles` has an entry for each tier that has children, the central controller's first. A
  parent publishes setpoints in its turns: cycles that are a multiple of its tier's entry. In other
  cycles its children do not await a setpoint, use the newest one, and publish all the same. In
  arming rounds, below 0, every parent acts whatever its period.
- Each key has at most one message in a cycle. If two come, the first one counts.
- In lockstep there are no deadlines: no agent goes on before you have answered. After a few
  seconds without an answer the run ends, and the launcher names the agent that did not answer.
- A cycle that was over before an agent came to it is skipped: the agent publishes nothing for it,
  and goes to the cycle under way. The plant never skips a cycle.
"""
    )


def _agents() -> tuple[tuple[str, Agent[Any]], ...]:
    team: dict[str, Agent[Any]] = {agent.name: agent for agent in controllers(_PLAN)}
    one = np.zeros((1, len(_TREE.leaves)))
    return (
        ("plant", Plant(_PLAN, Profile(mpp_kw=one, commitment_kw=one[:, 0]))),
        ("direct controller", team[INVERTER]),
        ("supervisor", team["c2"]),
        ("central controller", team[CENTRAL]),
    )


def _says(agent: Agent[Any], stage: Stage) -> Iterator[str]:
    """Yield the signals that a stage publishes in a cycle in which it hears the dispatch alone."""
    dispatch = Dispatch(
        0, 0, PLANT, (), power_kw=0.0, plant_rating_kw=1.0, commitment_kw=0.0, regulation_kw=0.0
    )
    inputs: dict[Any, Any] = dict.fromkeys((*stage.awaits, *stage.uses))
    inputs[DISPATCH.of(ROOT)] = dispatch
    _, outputs = agent.step(
        agent.initial_state(), Turn(stage.name, 0, 0, (0, 0, agent.name, ()), inputs)
    )
    names = dict.fromkeys(port.signal.name for port, _ in outputs if port.signal is not HELP)
    for name in names:
        yield name
        if name == RESIDUAL.name:
            yield "`help` if it is negative"


def _one_rule_for_time() -> Iterator[str]:
    yield from _paragraphs(
        """
### One rule for time

Of each input an agent keeps the newest message. Its *age* is the number of cycles since a newer one
was due: 0, if the newest message is that of this cycle, or of the sender's last turn where the
sender does not act in this one. A decision rests on the newest messages, whatever their age up to
`hold_cycles`. An input that is older than that, or of which nothing came, is *silent*.

`missing` says which inputs of the stage were not the ones that were due:

- `c2/inv07/setpoint@41`: the setpoint of cycle 41 was used, since that of the sender's last turn
  had not come.
- `c2/inv07/setpoint`: none was used. None ever came, or the newest one is too old.

Of an input without an entry, the message that was due was used. In lockstep `missing` is empty. A
device may leave it empty always, but then its recording does not tell what an answer rests on.
There is no other rule for messages that are late, lost or skipped: a late message is used in the
next decision if nothing newer has come by then.
"""
    )


def _direct_controller() -> Iterator[str]:
    yield from _paragraphs(
        f"""
### What a direct controller works out

It hears `run`, `dispatch`, `telemetry` and `setpoint`, and answers with `impp`, `residual`, `help`
if the residual is negative, and `command`. By the paper's rule (`scheme` is `paper`), to the last
digit, with its rating from the plan:

- `impp.power_kw` = min(telemetry.power_kw / telemetry.alpha, rating), and `stale_cycles` = 0. If
  alpha is below 1 and `available_kw` is there, from 0 to {1.0 + METER_TOLERANCE:g} times the
  rating, it takes the place of power / alpha.
- A measurement that cannot be right (NaN, negative, above {1.0 + METER_TOLERANCE:g} times the
  rating, alpha outside (0, 1]), or none that the estimate does not rest on already, leaves the last
  IMPP, and `stale_cycles` counts up. Before the first usable measurement the IMPP is 0.
- The request is the inverter's share of the dispatch: min(max(dispatch.power_kw, 0),
  plant_rating_kw) * (rating / plant_rating_kw); 0 while the dispatch is silent.
- `residual.power_kw` = IMPP - request. `help.missing_kw` = -residual, where that is above 0.
- `command.alpha` = target / IMPP, at least `alpha_min` ({HIDDEN_ALPHA_MIN:g} where `scheme` is
  `predictive` and `actuator` is `limit`); 1 where the target is the IMPP or more, to 1e-9 of it.
  `command.power_kw` = alpha * IMPP; the rating where alpha is 1.

**The target** follows a ladder, so that an inverter is safe without its parents, from cycle 0 on:

1. the setpoint of this cycle;
2. else the newest setpoint, while it is not silent;
3. else the inverter's own request, while the dispatch is not silent;
4. else no command is sent. The inverter's own revert timer decides; a simulated one goes on obeying
   its last command.

Where `scheme` is `predictive`, Heliarch's own controllers forecast the maximum of the interval that
now begins, instead of stating that of the last one (docs/decisions/0006,
`agents/control/forecast.py`). A parent takes an `impp` for what the node can give in this cycle,
however it was found. A device may state what it knows best, and may follow the rule above whatever
the scheme.
"""
    )


def _parent() -> Iterator[str]:
    yield from _paragraphs(
        """
### What a parent works out

The central controller and supervisors alike, with children in the order of `inverters`; a node's
rating is the sum of its inverters'. This is the arithmetic of a cycle in which all answer. The
order of sums, and what `predictive` gives on top between turns, are in `agents/parent.py`,
`agents/control/allocation.py` and `agents/control/correction.py`.

- `impp.power_kw` and `residual.power_kw` are the sums of the children's, `stale_cycles` is the
  largest of theirs plus the age of their `impp`, and `help.missing_kw` = -residual where that is
  above 0. A silent child has an IMPP of 0, and lacks its request. A residual counts only if it
  belongs to the cycle of the `impp`; otherwise the parent works it out as IMPP - request.
- A supervisor's target follows the ladder of a direct controller: setpoint, newest setpoint, own
  request, nothing. The central controller's target is the dispatch, held between 0 and the rating.
  Where `correction` is on, the central controller adds what the plant's `meter` shows to be
  missing: in each of its turns the correction grows by a share of the last turn's dispatch less the
  mean reading since then, from 0 to a tenth of the rating. It is 0 while the dispatch is the sum of
  all IMPPs or more.
- A child's `share_kw` is its part of the target by rating, but not less than the lowest alpha times
  its IMPP. Its headroom is IMPP - share. If the target is the sum of all IMPPs or more, each
  child's `power_kw` is its IMPP. Otherwise the children with negative headroom, in their order, ask
  their siblings one by one for what they lack, and each gives what is left of its headroom.
  `power_kw` is the lesser of share and IMPP, plus what the child gives. `help_given` lists what it
  gives and to whom, in both cases.
- Siblings are asked in the order of their correlation with the child that asks, the lowest first,
  equals in the order of the children. `neighbourhoods` has it: for each `node` the `hours`. The
  last one whose `from_time_ns` is not after `sim_time_ns` holds, with `correlation` as rows of a
  matrix over the children. Without an entry all are equal.
"""
    )


def _real_time() -> Iterator[str]:
    yield from _paragraphs(
        """
## Real time

With `cycle_wall_ns` above 0, cycle k begins `start_time_ns` + k * `cycle_wall_ns`, on the
CLOCK_MONOTONIC of the launcher's host, which all processes of one host share. `start_time_ns` comes
with `run`. Deadlines count from the beginning of the cycle:

- `tier_deadlines_ns` is empty: with h tiers below the central controller the order of a cycle has 2
  h + 2 places after the tick, and place p closes at 0.9 p / (2 h + 2) of it. A direct controller's
  `estimate` has place 1. An agent of level l (the central controller 0, its children 1) has
  `report` at 1 + h - l, `solve` at 1 + h + l; a direct controller has `actuate` at 1 + h + l. The
  plant's `apply` has the last place. The table above is for h = 2.
- Otherwise it has an entry for each tier, the central controller's first and the direct
  controllers' last: the time after the tick by which `solve` or `actuate` closes. The stages up to
  the central controller's `solve` share the time before its entry by their places. The plant goes
  on halfway between the last entry and the next tick.

**A device needs no common clock if it answers on arrival**: telemetry and dispatch in, `impp` and
`residual` out; setpoint in, `command` out. If an input does not come, it closes its stage by its
own clock, at the deadline or a little earlier. In a tree as above it waits for 0.14 of the cycle
after the first message of the cycle for telemetry and dispatch, and for 0.7 for the setpoint. In
arming rounds there are no deadlines. If neither telemetry nor dispatch comes, a device with a clock
goes through its stages all the same; one without is silent in that cycle.

**Times.** `ready_time_ns` is when the decision could be made: the last awaited input had come, or
the deadline had passed. `publish_time_ns` is when the message went out. All timing figures are
computed from these two and from the time at which the recorder hears a message. Times from a
foreign clock would spoil them, and the order of messages in time. A device with a clock of its own
sends, for each of the two, the `publish_time_ns` of the message that it answers plus the
nanoseconds since that came; or 0, which counts as unknown.
"""
    )


def _arming() -> Iterator[str]:
    yield from _paragraphs(
        """
## Before cycle 0, and the end

Cycles with numbers below 0 are *arming rounds*: whole cycles that prove all links.

**A controller** answers the messages of a round as in the run, with the round's cycle number and
`sequence` 0, from its initial state. The `dispatch` of a newer round takes it into that round and
ends the one under way. Other messages of a newer round that come before it are kept until then.
`run` of state `start` takes it into cycle 0, again from the initial state. A device may instead
enter a round, or cycle 0, with the first message of it that comes. `run` of state `stop` names the
first cycle that does not take place; the agent completes those before it, and then leaves. A device
that joins a run under way begins with the first cycle of which it hears.

**A plant** conducts the run:

1. It waits until the liveliness tokens of all other agents are there.
2. It sends rounds of cycle -999,999, -999,998 and so on: `dispatch`, `meter` and the `telemetry` of
   each inverter, under the conditions of cycle 0. It awaits every command of that round, and
   answers with `production`. A round is closed when all commands are in and the recorder has
   published `ready` with its cycle, which it does once it has heard every signal that comes in each
   cycle. A round that is not closed after some 0.3 s, and later ones after up to 3 s, is given up
   for the next.
3. `run` of state `start`, cycle 0, `cycle_wall_ns` as in the plan. `start_time_ns` is the monotonic
   time of the first tick, some 0.2 s ahead; in lockstep it is now. (`sequence` of `run`: 0.)
4. Cycles 0 to `cycles` - 1. At the tick: `dispatch` with the plant's rating, `meter` with the power
   fed in during the interval before, `telemetry` with what each inverter did in it. At the end:
   `production`. Where `actuator` is `fraction`, an inverter gives alpha times its maximum; where it
   is `limit`, it gives its maximum up to `command.power_kw`. An inverter without a command goes on
   obeying its last one.
5. `run` of state `stop`, with the cycle after the last one. (`sequence`: 1.)

The launcher follows an external plant through the recorder. It cannot stop one: on Ctrl-C the
controllers end, and the plant is left to itself.
"""
    )


def _rules() -> Iterator[str]:
    yield from _paragraphs(
        """
## Rules

- `source` is the agent's own name. Only the agent that the table of signals names may publish on a
  key.
- `cycle` is that of the stage, `sim_time_ns` = `start_time_ns` + `cycle` * `cycle_ns` of the plan,
  also below 0.
- `missing` has keys without the plant's name, see *One rule for time*.
- `sequence` counts the messages on the key from 0, from cycle 0 on. From its gaps the recorder
  tells what was lost. It begins anew after a restart.
- Integers have bounds: `cycle` above -2^31 and below 10^18, times [ns] between -2^62 and 2^62,
  those of the host's clock not below 0, counts from 0 to below 2^32, that of a notice below 2^62.
- Texts have bounds too: `source` and paths 200 characters; `missing` 4,096 entries of 256
  characters. No tree has agents that wait for so many messages, nor keys so long.
- Powers are in kW. Numbers have the bounds below. A message with a number beyond them is *absurd*
  and is not used.
"""
    )


def _bounds() -> Iterator[str]:
    yield "| message | field | from | to |"
    yield "|---|---|---|---|"
    for kind, bounds in BOUNDS.items():
        for bound in bounds:
            low, high = (_bound(bound, value) for value in (bound.low, bound.high))
            yield f"| {kind.__name__} | `{bound.field}` | {low} | {high} |"
    yield ""
    yield "*The rating* is that of the node that the message is about, or of the plant. A direct"
    yield "controller judges the telemetry of its inverter itself."
    yield ""


def _bound(bound: Bound, value: float) -> str:
    """Say a bound in words; those of powers are multiples of a rating."""
    if abs(value) == LARGEST:
        return "any finite number"
    if 0.0 < value < 1e-300:
        return "above 0"
    share = f"{round(value, 6):g}"
    if not bound.field.endswith("_kw") or value == 0.0:
        return share
    return {"1": "the rating", "-1": "- the rating"}.get(share, f"{share} times the rating")


def _wrong_answers() -> Iterator[str]:
    yield from _paragraphs(
        """
## Wrong answers

None of them stops another agent. The recorder, which hears everything, counts what is wrong by key
and cause, and gives an example in its log, on the launcher's screen and in the summary: of absurd
messages one for each field that was wrong. Listeners count what they drop by key and cause too,
with examples in their logs; the summary has the larger count of the two. What one agent did wrong
in the same way on several keys is one line on the screen; the JSON has each key.

| what | cause | what becomes of it |
|---|---|---|
| no msgpack, a wrong type, a field too few or too many | `undecodable` | dropped |
| an integer, `source` or `missing` beyond its bounds | `undecodable` | dropped |
| a key of a node or signal that the run does not have | `unknown` | dropped |
| `source` is not who may publish on the key | `foreign` | dropped |
| an earlier cycle than the newest message on the key, or an arming round | `late` | dropped |
| a cycle ahead by more than the longest period | `other_cycle` | dropped |
| a second message on a key in a cycle | `duplicate` | dropped: the first one counts |
| the same, as the recorder hears it | `repeated` | recorded |
| a setpoint in a cycle that is not its sender's turn | `unexpected` | dropped |
| NaN, infinite, beyond the bounds in *Rules* | `absurd` | not used: the newest usable one holds |
| a `dispatch` below 0 or above the rating | none, but a `notice` | held within, and acted on |
| a `sim_time_ns` that is not its cycle's | `absurd` | used: only the recorder looks at it |
| a `run` that begins over 10 s from now, in real time | `absurd` | it begins now instead |
| a `run` with another `cycle_wall_ns` than the plan | `absurd` | that of the plan holds |
| a second `run` of state `start` | none | ignored, but recorded |
| nothing | `missing` of its listeners | real time: older input or none; lockstep: the run ends |
| more than an agent can look at | `flooded` | of 10,000 that wait, 100 of each key are kept |

A program that uses both the key and the name of another agent cannot be told from that agent: the
first message in a cycle counts. Zenoh's access control says who may link with the agents.
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

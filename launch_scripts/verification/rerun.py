"""One agent re-run on the inputs that its recorded outputs used.

Which inputs those were, the outputs tell: each carries the keys of the inputs that its sender had
to do without in that cycle, whether they came late, were dropped or never were sent, and the cycle
of the late word that it used in their place. All other inputs of the cycle it had, so the recording
has them too. An output also tells of cycles that its sender gave up before it. Deadlines need no
clock then: a run in real time is re-run like one in lockstep.

Where the recording lost a message, nobody knows the state of who needed it; nor, in real time, of
an agent of whose stage nothing is left that would tell what it had to do without. Such an agent is
re-run from several states: the one that it would have otherwise, and that one with every number in
it altered. Once it has heard each of its inputs anew, what it says from all alike does not depend
on what was lost, and is compared. What depends on it is counted as not compared.

An external agent may say several things in a cycle. Its listener used one of them: the agent is
re-run on those with which it says most of what it said.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain, islice, product
from typing import Any, Final, TypeAlias

from agents.agent import Agent, Stage, Turn
from agents.plan import RunPlan
from bus_schemas.bus import Delivery
from bus_schemas.codec import encode
from bus_schemas.messages import Message
from bus_schemas.missing import SKIPPED, Absence, absence
from bus_schemas.signals import Port
from launch_scripts.verification.account import Account, Difference, Kind
from launch_scripts.verification.altered_state import altered_states
from launch_scripts.verification.comparison import Comparison, FieldDifference
from launch_scripts.verification.guarded_agent import AgentFailure, GuardedAgent, State
from launch_scripts.verification.recorded_cycles import RecordedCycle
from launch_scripts.verification.unused_inputs import UnusedInputs

_Choice: TypeAlias = dict[tuple[Port[Message], int], Message]
"""Of a port and a cycle of which there are several words the one that was used."""

_MOST_CHOICES: Final = 256
"""So many are tried: with a few devices that say two things each all, otherwise the likely ones."""


@dataclass(slots=True)
class _Doubt:
    """An agent whose state nobody knows.

    Attributes
    ----------
    altered
        Other states than the one that it would have had without the loss.
    awaited
        The ports on which it still must hear something before anything is compared.
    """

    altered: list[State]
    awaited: set[Port[Message]]


class AgentRerun:
    """One agent on its way through a recording.

    Parameters
    ----------
    name
        Name of the agent.
    make
        Makes the agent, as the code is now.
    says
        The ports on which it publishes, as far as they are recorded.
    plan
        Of the recorded run.
    comparison
        What counts as equal.

    Attributes
    ----------
    account
        What it came to so far.
    """

    def __init__(
        self,
        name: str,
        make: Callable[[], Agent[Any]],
        says: Collection[Port[Message]],
        plan: RunPlan,
        comparison: Comparison,
    ) -> None:
        self.name = name
        self.account = Account()
        self._says = frozenset(says)
        self._unused = UnusedInputs(name, plan)
        self._plan = plan
        self._comparison = comparison
        self._agent: GuardedAgent | None = None
        self._state: State = None
        self._doubt: _Doubt | None = None
        # What the recording lacks was lost, or never said because the agent had come to its end:
        # to be told apart once it speaks again, or not.
        self._unsaid = Account()
        # The same of cycles in which it was not waited for: its words may lie further on.
        self._unsaid_behind = Account()
        self._left_behind: dict[str, int] = {}
        self._lacks: list[Difference] = []
        try:
            self._agent = GuardedAgent(make)
            self._state = self._agent.initial_state()
        except AgentFailure as failure:
            self._agent = None
            self.account.add(Difference("fails", 0, "", None, text=str(failure)))

    def take(self, cycle: RecordedCycle) -> None:
        """Re-run a cycle and compare what the agent says in it with what it said."""
        recorded = {port: cycle.messages[port] for port in self._says.intersection(cycle.messages)}
        if recorded:
            self.account.absorb(self._unsaid)
            self._unsaid, self._unsaid_behind = Account(), Account()
        self._left_behind.update(dict.fromkeys(cycle.not_awaited, cycle.number))
        rerun = _CycleRerun(self.name, cycle, _absences(recorded.values()), self._unused)
        if self._agent is None:
            self.account.leave_out(cycle.number, len(recorded))
        else:
            rerun = self._on_words_used(self._agent, rerun, recorded)
            self._take_guarded(self._agent, rerun, recorded)
            self._unused.keep(cycle, rerun.inputs)
        self.account.recorded += len(recorded)
        for port, old in cycle.repeated:
            if port in self._says:
                self.account.recorded += 1
                self.account.add(rerun.difference("recorded twice", "", port, message=old))

    def conclude(self, stop_cycle: int | None, newest: Mapping[Port[Message], int]) -> None:
        """Settle what is not certain before the end of the recording.

        Parameters
        ----------
        stop_cycle
            All cycles before it took place, by the plant's word. None: the run or its recording
            broke off, so that of each key the last messages may be lost.
        newest
            Cycle of the newest message of each port.
        """
        if stop_cycle is not None:
            self.account.absorb(self._unsaid)
            self.account.absorb(self._unsaid_behind)
        for lack in self._lacks:
            took_place = stop_cycle is not None and lack.cycle < stop_cycle
            if took_place or (lack.port is not None and newest.get(lack.port, -1) > lack.cycle):
                self.account.add(lack)

    def _on_words_used(
        self, agent: GuardedAgent, first: _CycleRerun, recorded: Mapping[Port[Message], Message]
    ) -> _CycleRerun:
        """Return a rerun on those words of external agents with which it says most of what it said.

        There may be a true difference besides: it is to be told by itself.
        """
        if not self._plan.external:
            return first
        best, fewest = first, len(recorded) + 1
        try:
            stages = agent.stages(first.cycle.number)
            several = first.several_words(stages, self._plan.external)
            for choice in islice(_choices(several), _MOST_CHOICES):
                tried = first.anew(choice)
                self._close_stages(agent, stages, self._state, tried)
                others = self._said_otherwise(tried, recorded)
                if others < fewest:
                    best, fewest = first.anew(choice), others
                if not fewest:
                    break
        except AgentFailure:
            pass  # It is found again, and told.
        return best

    def _said_otherwise(self, rerun: _CycleRerun, recorded: Mapping[Port[Message], Message]) -> int:
        """Count the recorded messages that a rerun does not say as they were."""
        said = {port: message for _, port, message in rerun.said}
        return sum(
            port not in said or bool(self._comparison.differences(port, old, said[port]))
            for port, old in recorded.items()
        )

    def _take_guarded(
        self, agent: GuardedAgent, rerun: _CycleRerun, recorded: dict[Port[Message], Message]
    ) -> None:
        number = rerun.cycle.number
        rest = dict(recorded)
        try:
            stages = agent.stages(number)
            self._state, lacking = self._close_stages(agent, stages, self._state, rerun)
            self.account.missed_inputs += rerun.missed
            self.account.late_used += rerun.late_used
            if (
                lacking is not None
                and self._doubt is None
                and not self._lies_behind(rerun, lacking)
            ):
                self._lacks.append(rerun.difference("input not recorded", rerun.stage, lacking))
            is_lost = lacking is not None or not self._is_told(rerun, stages, recorded)
            doubtful = self._doubtful_ports(agent, stages, rerun, is_lost=is_lost)
            self._compare(rerun, rest, doubtful)
            if lacking is None:
                self._compare_rest(rerun, rest, doubtful)
            if is_lost:
                self._doubt = self._new_doubt(agent, number, self._state)
            elif not rest:
                self.account.resume()
        except AgentFailure as failure:
            # Of the cycle's earlier stages the messages are there to be compared.
            self._compare(rerun, rest, self._says if self._doubt else frozenset())
            self.account.add(rerun.difference("fails", rerun.stage, None, text=str(failure)))
            self._agent = None
        self.account.leave_out(number, len(rest))

    def _doubtful_ports(
        self, agent: GuardedAgent, stages: Sequence[Stage], rerun: _CycleRerun, *, is_lost: bool
    ) -> Collection[Port[Message]]:
        """Return the ports of messages that may depend on what was lost."""
        doubt = self._doubt
        if doubt is None:
            return ()
        if is_lost:
            return self._says
        others = [rerun.anew() for _ in doubt.altered]
        try:
            doubt.altered = [
                self._close_stages(agent, stages, state, other)[0]
                for state, other in zip(doubt.altered, others, strict=True)
            ]
        except AgentFailure:  # It need not be able to live with a state that it never had.
            self._doubt = self._new_doubt(agent, rerun.cycle.number, self._state)
            return self._says
        doubt.awaited.difference_update(rerun.inputs)
        if doubt.awaited:
            return self._says
        alike = min((_said_alike(rerun, other) for other in others), key=len)
        if all(len(alike) == len(run.said) for run in (rerun, *others)):
            return ()
        return self._says.difference(alike)

    def _new_doubt(self, agent: GuardedAgent, cycle: int, state: State) -> _Doubt:
        """Of the next cycles any may be the turn of a tier above: all must be heard anew."""
        next_cycles = range(cycle + 1, cycle + 1 + self._plan.periods.longest)
        awaited = {
            port
            for number in next_cycles
            for stage in agent.stages(number)
            for port in stage.awaits
        }
        return _Doubt(altered_states(state), awaited)

    def _lies_behind(self, rerun: _CycleRerun, lacking: Port[Message]) -> bool:
        """Whether an input may lie further on in the file, since nobody waited for its sender."""
        return rerun.cycle_wanted(lacking) <= self._left_behind.get(lacking.publisher, -1)

    def _is_told(
        self, rerun: _CycleRerun, stages: Sequence[Stage], recorded: Collection[Port[Message]]
    ) -> bool:
        return self._plan.lockstep or not stages or rerun.is_told(stages, recorded)

    def _close_stages(
        self, agent: GuardedAgent, stages: Sequence[Stage], state: State, rerun: _CycleRerun
    ) -> tuple[State, Port[Message] | None]:
        """Close the stages of a cycle with the inputs that they had.

        Returns the state after them, and the first input that the recording lacks, if any: the
        agent cannot go on then.
        """
        number = rerun.cycle.number
        sim_time_ns = self._plan.sim_time_ns(number)
        for stage in stages:
            rerun.stage = stage.name
            rerun.hear(stage)
            announced = frozenset(agent.announced(stage, rerun.inputs))
            rerun.hear_announced(announced)
            lacking = rerun.lacking(stage, announced)
            if lacking is not None:
                return state, lacking
            stamp = (number, sim_time_ns, self.name, rerun.absent)
            turn = Turn(stage.name, number, sim_time_ns, stamp, rerun.inputs)
            state, outputs = agent.step(state, turn)
            rerun.say(outputs)
        return state, None

    def _compare(
        self,
        rerun: _CycleRerun,
        rest: dict[Port[Message], Message],
        doubtful: Collection[Port[Message]],
    ) -> None:
        """Compare what was said and is said again, and take it out of the rest."""
        pairs = []
        is_behind = self.name in rerun.cycle.not_awaited
        unsaid = self._unsaid_behind if is_behind else self._unsaid
        for stage, port, message in rerun.said:
            if port in doubtful:
                continue
            old = rest.pop(port, None)
            if old is not None:
                pairs.append((port, old))
                self._compare_pair(rerun, stage, port, old, message)
            elif rerun.cycle.took_place:
                unsaid.add(rerun.difference("only new", stage, port, message=message))
        rerun.said = []
        # One clock stamped them all. Their order in the file would be the order of arrival.
        in_time = sorted(pairs, key=lambda pair: pair[1].publish_time_ns)
        if in_time != pairs:
            orders = [", ".join(str(port) for port, _ in order) for order in (in_time, pairs)]
            text = "recorded {}; now {}".format(*orders)
            self.account.add(rerun.difference("other order", "", in_time[0][0], text=text))

    def _compare_rest(
        self,
        rerun: _CycleRerun,
        rest: dict[Port[Message], Message],
        doubtful: Collection[Port[Message]],
    ) -> None:
        """Take out of the rest what the agent surely does not say any more."""
        for port in [port for port in rest if port not in doubtful]:
            old = rest.pop(port)
            self.account.add(rerun.difference("only recorded", "", port, message=old))

    def _compare_pair(
        self, rerun: _CycleRerun, stage: str, port: Port[Message], old: Message, new: Message
    ) -> None:
        self.account.compared += 1
        fields = self._comparison.differences(port, old, new)
        if fields:
            found = rerun.difference("differs", stage, port, message=old, fields=fields)
            self.account.add(found)


def _said_alike(one: _CycleRerun, other: _CycleRerun) -> list[Port[Message]]:
    """Return the ports of what two reruns of a cycle say alike, up to the first difference.

    What is said after it rests on the same memory. That it is alike may be chance: a value that
    ends at a rating does not tell where it comes from.
    """
    ports: list[Port[Message]] = []
    for (_, port, message), (_, its_port, its_message) in zip(one.said, other.said, strict=False):
        if port is not its_port or encode(message) != encode(its_message):
            break
        ports.append(port)
    return ports


def _choices(several: Mapping[tuple[Port[Message], int], Sequence[Message]]) -> Iterator[_Choice]:
    """Yield ways to choose one of several words of each place, the likely ones first.

    A device has its own manner: of all that it says the first one is used, or the second.
    """
    most = max(map(len, several.values()), default=0)
    alike = (
        tuple(words[min(place, len(words) - 1)] for words in several.values())
        for place in range(most)
    )
    for words in chain(alike, product(*several.values()) if several else ()):
        yield dict(zip(several, words, strict=True))


def _absences(recorded: Iterable[Message]) -> frozenset[Absence]:
    """Return what an agent says in a cycle that it had to do without."""
    return frozenset(absence(entry) for message in recorded for entry in message.missing)


class _CycleRerun:
    """One agent in one cycle: what it was given, what it had to do without, what it says."""

    def __init__(
        self,
        agent: str,
        cycle: RecordedCycle,
        absences: frozenset[Absence],
        unused: UnusedInputs,
        choice: _Choice | None = None,
    ) -> None:
        self.cycle = cycle
        self.is_skipped = agent in cycle.skipped_by
        self.stage = ""
        self.inputs: dict[Port[Message], Message] = {}
        self.missed = self.late_used = 0
        self.said: list[tuple[str, Port[Message], Message]] = []
        self._agent = agent
        self._absences = absences
        self._unused = unused
        self._choice = choice or {}
        self._cycle_used = {entry.key: entry.cycle for entry in absences}
        skipped = [entry for entry in absences if entry.key == SKIPPED]
        self.absent = tuple(
            map(str, [Absence(SKIPPED, cycle.number)] if self.is_skipped else skipped)
        )

    def anew(self, choice: _Choice | None = None) -> _CycleRerun:
        """Return another rerun of the same cycle, on the same words or on others."""
        choice = self._choice if choice is None else choice
        return _CycleRerun(self._agent, self.cycle, self._absences, self._unused, choice)

    def several_words(
        self, stages: Sequence[Stage], speakers: Collection[str]
    ) -> dict[tuple[Port[Message], int], tuple[Message, ...]]:
        """Return the inputs, by port and cycle, of which some agents said more than one thing."""
        found = {}
        for stage in stages if speakers else ():
            for port in stage.awaits | stage.on_need | stage.takes_late:
                words = self._words(port) if port.publisher in speakers else ()
                if len(words) > 1:
                    found[port, words[0].cycle] = words
        return dict(sorted(found.items(), key=lambda entry: str(entry[0])))

    def cycle_wanted(self, port: Port[Message]) -> int:
        """Return the cycle of the word that was used of a port."""
        used = self._cycle_used.get(str(port))
        return self.cycle.number if used is None else used

    def _words(self, port: Port[Message]) -> tuple[Message, ...]:
        """Return what the recording holds of an input that the agent had, in time or late."""
        if self._had_in_time(port):
            return self.cycle.words(port)
        used = self._cycle_used[str(port)]
        return () if used is None else self._unused.find(port, used)

    def _word(self, port: Port[Message]) -> Message | None:
        """Return the word of an input that the agent used, None if the recording lacks it."""
        words = self._words(port)
        return self._choice.get((port, words[0].cycle), words[0]) if words else None

    def hear(self, stage: Stage) -> None:
        """Take in what the recording has for a stage, as far as the agent had it."""
        if self.is_skipped:
            self.absent += tuple(sorted(map(str, stage.awaits)))
            return
        messages = self.cycle.messages
        if not self._absences:
            self.inputs.update({port: messages[port] for port in stage.awaits if port in messages})
            for (port, _), word in self._choice.items():
                if port in stage.awaits:
                    self.inputs[port] = word
            return
        absent = []
        for port in stage.awaits | stage.on_need | stage.takes_late:
            if self._had_in_time(port):
                if port in stage.awaits:
                    self._take(port)
                continue
            used = self._cycle_used[str(port)]
            absent.append(str(Absence(str(port), used)))
            self.missed += port not in stage.takes_late
            self.late_used += used is not None
            self._take(port)
        # Of each stage in the order of the alphabet, as the sequencer has it.
        self.absent += tuple(sorted(absent))

    def hear_announced(self, announced: Iterable[Port[Message]]) -> None:
        """Take in what comes on need. Without its announcement nobody knows whether it came."""
        for port in announced:
            if self._had_in_time(port):
                self._take(port)

    def _take(self, port: Port[Message]) -> None:
        word = self._word(port)
        if word is not None:
            self.inputs[port] = word

    def _had_in_time(self, port: Port[Message]) -> bool:
        return str(port) not in self._cycle_used

    def lacking(self, stage: Stage, announced: frozenset[Port[Message]]) -> Port[Message] | None:
        """Return an input of a stage that the agent had and the recording lacks, if any.

        It had what nobody says was missing, and the late words that it names.
        """
        if self.is_skipped:
            return None
        needed = stage.awaits.union(announced)
        late = [port for port in stage.takes_late if self._cycle_used.get(str(port)) is not None]
        lacking = [
            port
            for port in needed.union(late).difference(self.inputs)
            if self._had_in_time(port) or self._cycle_used[str(port)] is not None
        ]
        return min(lacking, key=str, default=None)

    def say(self, outputs: Iterable[Delivery]) -> None:
        """Take down what the agent says; of a cycle that it skips, what nobody acts on."""
        self.said += [
            (self.stage, port, message)
            for port, message in outputs
            if not (self.is_skipped and port.signal.listeners)
        ]

    def is_told(self, stages: Sequence[Stage], recorded: Collection[Port[Message]]) -> bool:
        """Whether a recorded message tells what the cycle's stages had to do without.

        Each tells of its own stage and those before it. Of a cycle that was skipped a later one
        tells.
        """
        if self.is_skipped:
            return True
        stage_of = {port: stage for stage, port, _ in self.said}
        telling = {stage_of.get(port, stages[-1].name) for port in recorded}
        for stage in reversed(stages):
            if stage.name in telling:
                return True
            if stage.awaits or stage.takes_late:
                return False
        return True

    def difference(
        self,
        kind: Kind,
        stage: str,
        port: Port[Message] | None,
        *,
        message: Message | None = None,
        fields: tuple[FieldDifference, ...] = (),
        text: str = "",
    ) -> Difference:
        """Return a difference in this cycle, with what the agent was given."""
        number, inputs = self.cycle.number, tuple(self.inputs.items())
        return Difference(kind, number, stage, port, fields, message, inputs, self.absent, text)

"""Which messages belong to the recording: each port has one word a cycle, near the plant's cycle.

Of an external agent that says several things in a cycle, a listener uses the first one that is not
too far ahead of where it stands itself. Only the listener knows which one that was, so all of them
are recorded, and `verify` finds it by what the listener then said. A word that repeats another,
or that nobody listens to, tells nothing new and is set aside.
"""

from __future__ import annotations

from typing import Final, NamedTuple

from msgspec.structs import replace

from agents.plan import RunPlan
from bus_schemas.messages import Message
from bus_schemas.signals import Port

PATIENCE_S: Final = 10.0
"""How long the recorder may stand still in real time: what it hears then is out of order."""

REPEATED: Final = "repeated"
"""The cause of complaints about further words in a cycle, which are recorded all the same."""

FAR_OFF: Final = frozenset({"late", "other_cycle"})
"""The causes of complaints about words of a cycle that is too far from the plant's."""

MOST_WORDS: Final = 8
"""So many different words of a port are recorded in a cycle."""

_CYCLE_WINDOW: Final = 1000
"""How many cycles ahead of the plant's last word a message can be on another link, generously."""

_EXTERNAL_WINDOW: Final = 20
"""The same of an external agent in lockstep, which may be of a wrong cycle."""

_REMEMBERED_CYCLES: Final = 100
"""In so many cycles of an agent it is known that there was a word: there must be no second."""

_LONGEST_WINDOW: Final = 10_000


class Objection(NamedTuple):
    """What is wrong with a message.

    Attributes
    ----------
    cause, text
        In one word, and in several.
    is_recorded
        Whether it belongs to the recording all the same.
    """

    cause: str
    text: str
    is_recorded: bool = False


class SpokenWords:
    """What has been said in the cycles around the plant's.

    Parameters
    ----------
    plan
        Of the run.
    """

    def __init__(self, plan: RunPlan) -> None:
        self._external = frozenset(plan.external)
        self._ahead, self._behind = _window(plan)
        self._own_words: dict[Port[Message], dict[int, None]] = {}
        self._external_words: dict[Port[Message], dict[int, list[Message]]] = {}

    def objection(self, port: Port[Message], message: Message, newest: int) -> Objection | None:
        """Say what is wrong with a message of the run, None if nothing; and remember it.

        Parameters
        ----------
        port, message
            The message, not of an arming round.
        newest
            The plant's newest cycle, as far as it has been heard.
        """
        if port.publisher in self._external:
            return self._objection_to_external(port, message, newest)
        cycle = message.cycle
        if cycle > newest + _CYCLE_WINDOW:
            return _far_off(cycle, newest)
        if not port.signal.is_cyclic:
            return None
        known = self._own_words.setdefault(port, {})
        if cycle in known:
            return _second(cycle)
        known[cycle] = None
        if len(known) > _REMEMBERED_CYCLES:
            del known[next(iter(known))]
        return None

    def _objection_to_external(
        self, port: Port[Message], message: Message, newest: int
    ) -> Objection | None:
        cycle = message.cycle
        # Beyond this window nothing is remembered, so that what repeats itself would not be known.
        if cycle < newest - self._behind:
            return _far_off(cycle, newest, "late")
        if cycle > newest + self._ahead:
            return _far_off(cycle, newest)
        if not port.signal.is_cyclic:
            return None
        known = self._external_words.setdefault(port, {})
        words = known.setdefault(cycle, [])
        if not words:
            words.append(message)
            self._forget(known, newest)
            return None
        if len(words) == MOST_WORDS or not port.signal.listeners or _says_again(message, words):
            return _second(cycle)
        words.append(message)
        return Objection(REPEATED, f"it says something else in cycle {cycle}", is_recorded=True)

    def _forget(self, known: dict[int, list[Message]], newest: int) -> None:
        """Forget what lies behind the window, in large pieces."""
        if len(known) > 2 * (self._behind + self._ahead + 1):
            for cycle in [cycle for cycle in known if cycle < newest - self._behind]:
                del known[cycle]


def _window(plan: RunPlan) -> tuple[int, int]:
    """How many cycles ahead of the plant's and behind it the words of external agents can be.

    A listener takes what is ahead of it by the longest period, and may be one cycle ahead itself.
    A recorder that has stood still hears one link before the other.
    """
    ahead = max(_EXTERNAL_WINDOW, plan.periods.longest + 1)
    if not plan.lockstep:
        ahead += min(int(PATIENCE_S * 1e9 / plan.cycle_wall_ns), _LONGEST_WINDOW)
    return ahead, max(_REMEMBERED_CYCLES, 2 * ahead)


def _says_again(message: Message, words: list[Message]) -> bool:
    """Whether a word says what another one said, whenever they were sent."""
    return any(
        replace(message, publish_time_ns=word.publish_time_ns, sequence=word.sequence) == word
        for word in words
    )


def _far_off(cycle: int, newest: int, cause: str = "other_cycle") -> Objection:
    return Objection(cause, f"it is of cycle {cycle}, this is {newest}")


def _second(cycle: int) -> Objection:
    return Objection("duplicate", f"it came twice in cycle {cycle}")

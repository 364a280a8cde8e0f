"""Bugs that a campaign must find, as patches of the product's source: file, what it has, what then.

The first ten were planted first; the others were chosen before any campaign had been run on them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple


class Patch(NamedTuple):
    """A change of one place of a file."""

    file: str
    old: str
    new: str


INPUTS, DIRECT, PARENT = "agents/inputs.py", "agents/direct.py", "agents/parent.py"
INVERTERS, LOOP, STANDBY = "sim_plant/inverters.py", "agents/loop.py", "agents/standby.py"

OF_FRACTIONS: Final = frozenset({"a reverted inverter stays limited"})
"""Bugs that show only where commands are a fraction of the maximum, and no limit."""

BUGS: Final[dict[str, Sequence[Patch]]] = {
    "an inverter never reverts": [
        Patch(
            INVERTERS,
            "is_over = cycle - renewed_in >= self._revert_cycles",
            "is_over = renewed_in < 0",
        )
    ],
    "a controller without a setpoint takes its rating": [
        Patch(
            DIRECT,
            "target_kw = share_kw if setpoint is None or lost else setpoint.power_kw",
            "target_kw = self._rating_kw if setpoint is None else setpoint.power_kw",
        )
    ],
    "a command before the first telemetry": [
        Patch(DIRECT, "if state.telemetry_cycle == _NEVER:", "if False:")
    ],
    "a late message replaces a newer one": [
        Patch(INPUTS, "elif of <= one.newest_cycle:", "elif of == one.newest_cycle:"),
        Patch(INPUTS, "if message.cycle <= one.newest_cycle or", "if"),
    ],
    "a donor gives twice": [
        Patch("agents/control/allocation.py", "headroom_kw[donor] -= power_kw", "pass")
    ],
    "old messages are held for ever": [Patch(INPUTS, "if age > self._hold_cycles:", "if False:")],
    "no incarnation is checked": [
        Patch(INPUTS, "if incarnation < one.incarnation:", "if False:"),
        Patch(INPUTS, " or message.incarnation < one.incarnation:", ":"),
    ],
    "a command without a revert value": [
        Patch(DIRECT, "revert_kw = share_kw if self._reverts else None", "revert_kw = None")
    ],
    "a supervisor ignores its fallback": [
        Patch(
            PARENT,
            "target_kw = share_kw if setpoint is None else setpoint.power_kw",
            "target_kw = None if setpoint is None else setpoint.power_kw",
        )
    ],
    "a silent child counts 0": [
        Patch(
            PARENT,
            "reports.append(Report(share_kw, 0.0, expired,",
            "reports.append(Report(0.0, 0.0, expired,",
        )
    ],
    # Chosen before the campaign was tuned.
    "a late input is forgotten at once": [
        Patch(INPUTS, "if age > self._hold_cycles:", "if age > 0:")
    ],
    "an inverter reverts to its setpoint": [
        Patch(
            DIRECT,
            "revert_kw = share_kw if self._reverts",
            "revert_kw = target_kw if self._reverts",
        )
    ],
    "the share of a silent child is given away as well": [
        Patch(PARENT, "max(target_kw - expired_kw, 0.0)", "target_kw")
    ],
    "a standby takes over under the old incarnation": [
        Patch(STANDBY, "self.silent, self.incarnation = False, cycle", "self.silent = False"),
        Patch(
            LOOP,
            "incarnation = cycle if takes_over else standby.incarnation",
            "incarnation = standby.incarnation",
        ),
    ],
    "an inverter that is not heard is never lost": [
        Patch(
            "agents/control/impp.py",
            "stale_cycles=last.stale_cycles + 1",
            "stale_cycles=last.stale_cycles",
        )
    ],
    "a residual of another cycle is used": [
        Patch(
            PARENT,
            "if residual is not None and residual.cycle == impp.cycle:",
            "if residual is not None:",
        )
    ],
    "a late joiner takes its first dispatch for the start of the run": [
        Patch(
            LOOP,
            "self.begin(began_ns - cycle * cycle_wall_ns, now_ns, cycle)",
            "self.begin(began_ns, now_ns, cycle)",
        )
    ],
    "the correction has no bound": [
        Patch(
            "agents/control/correction.py",
            "HIGHEST_CORRECTION: Final = 0.1",
            "HIGHEST_CORRECTION: Final = 9.0",
        )
    ],
    "an expired input is used, and said to be missing": [
        Patch(
            INPUTS,
            "            found[port] = message",
            "            found[port] = one.newest",
        )
    ],
    "a supervisor follows no setpoint of an earlier cycle": [
        Patch(
            PARENT,
            "target_kw = share_kw if setpoint is None else setpoint.power_kw",
            "old = setpoint is None or setpoint.cycle < turn.cycle\n"
            "        target_kw = share_kw if old else setpoint.power_kw",
        )
    ],
    # The two that a reading of the code found.
    "a reverted inverter stays limited": [
        Patch(
            INVERTERS,
            "commanded_kw = command.power_kw if self._limits else inf",
            "commanded_kw = command.power_kw if self._limits else limit_kw[position]",
        )
    ],
    "a tripped inverter is counted on": [
        Patch("agents/control/impp.py", "-METER_TOLERANCE * rating_kw", "0.0"),
        Patch("agents/control/impp.py", "return last.stale_cycles > hold_cycles", "return False"),
    ],
    # Planted by somebody who had not written the campaign.
    "hold lasts a cycle longer": [
        Patch(INPUTS, "if age > self._hold_cycles:", "if age > self._hold_cycles + 1:")
    ],
    "an old dispatch is accepted for ever": [
        Patch(
            INPUTS,
            "if age > self._hold_cycles:",
            'if age > self._hold_cycles and str(port) != "dispatch":',
        )
    ],
    "the correction winds up while the meter is silent": [
        Patch(
            PARENT,
            "meter.cycle <= state.meter_cycle",
            "meter.cycle < state.meter_cycle",
        )
    ],
    "the correction goes on while no inverter is curtailed": [
        Patch(
            "agents/control/correction.py",
            "    if is_free:\n        return 0.0\n",
            "",
        )
    ],
    "the most correlated sibling helps first": [
        Patch(
            "agents/control/allocation.py",
            "key=row.__getitem__)",
            "key=row.__getitem__, reverse=True)",
        )
    ],
    "another child than the donor is topped up": [
        Patch(
            "agents/control/allocation.py",
            "            donor = donors[line]\n",
            "            donor = donors[-1 - line]\n",
        )
    ],
    "a setpoint names the donor as the one in need": [
        Patch(PARENT, "self._children[asking].path", "self._children[donor].path")
    ],
    "an inverter learns its revert value once": [
        Patch(
            INVERTERS,
            "if command.revert_kw is not None and self._revert_is_commanded[position]:",
            "if command.revert_kw is not None and self._revert_is_commanded[position] "
            "and revert_kw[position] == self._revert_kw[position]:",
        )
    ],
    "an old command renews the revert timer": [
        Patch(INVERTERS, "renewed[position] = max(command.cycle, 0)", "renewed[position] = cycle")
    ],
    "an inverter that is not heard is not probed": [
        Patch(
            DIRECT,
            "        lost = share_kw is not None and is_lost",
            "        lost = False and is_lost",
        )
    ],
    "old telemetry is taken for new": [
        Patch(
            DIRECT,
            "if telemetry is not None and 0 <= telemetry.cycle <= state.telemetry_cycle:",
            "if telemetry is None:",
        )
    ],
    "a report hides how old it is": [
        Patch(
            PARENT,
            "stale_cycles = impp.stale_cycles + turn.cycle - impp.cycle",
            "stale_cycles = impp.stale_cycles",
        )
    ],
    "a call for help is not sent": [
        Patch("agents/dispatch.py", "if residual_kw < 0.0:", "if False:")
    ],
    "a replaced process goes on speaking": [
        Patch(STANDBY, "        self.silent = True\n", "        self.silent = False\n")
    ],
    "a restarted process speaks as the first one": [
        Patch(LOOP, "self.standby.incarnation = cycle", "self.standby.incarnation = 0")
    ],
    "a parent gives up on its own children between their reports": [
        Patch(
            INPUTS,
            "age = cycle - message.cycle - one.period + 1",
            "age = cycle - message.cycle - one.period + 2",
        )
    ],
}

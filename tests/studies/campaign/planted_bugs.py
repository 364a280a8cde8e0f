"""Bugs that a campaign must find, as patches of the product's source.

The first ten were planted first. Those from "a late input" to "no setpoint of an earlier cycle"
were chosen before the campaign was tuned, the next two were found by reading the code, and the
others were planted by somebody who had not written the campaign.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

_PATCHES: Final = r"""
# sim_plant/inverters.py: an inverter never reverts
- is_over = cycle - renewed_in >= self._revert_cycles
+ is_over = renewed_in < 0
# agents/direct.py: a controller without a setpoint takes its rating
- target_kw = share_kw if setpoint is None or lost else setpoint.power_kw
+ target_kw = self._rating_kw if setpoint is None else setpoint.power_kw
# agents/direct.py: a command before the first telemetry
- if state.telemetry_cycle == _NEVER:
+ if False:
# agents/inputs.py: a late message replaces a newer one
- elif of <= one.newest_cycle:
+ elif of == one.newest_cycle:
# agents/inputs.py: a late message replaces a newer one
- if message.cycle <= one.newest_cycle or
+ if
# agents/control/allocation.py: a donor gives twice
- headroom_kw[donor] -= power_kw
+ pass
# agents/inputs.py: old messages are held for ever
- if age > self._hold_cycles:
+ if False:
# agents/inputs.py: no incarnation is checked
- if incarnation < one.incarnation:
+ if False:
# agents/inputs.py: no incarnation is checked
-  or message.incarnation < one.incarnation:
+ :
# agents/direct.py: a command without a revert value
- power_kw=power_kw, revert_kw=share_kw
+ power_kw=power_kw, revert_kw=None
# agents/parent.py: a supervisor ignores its fallback
- target_kw = share_kw if setpoint is None else setpoint.power_kw
+ target_kw = None if setpoint is None else setpoint.power_kw
# agents/parent.py: a silent child counts 0
- reports.append(Report(share_kw, 0.0, expired,
+ reports.append(Report(0.0, 0.0, expired,
# agents/inputs.py: a late input is forgotten at once
- if age > self._hold_cycles:
+ if age > 0:
# agents/direct.py: an inverter reverts to its setpoint
- power_kw=power_kw, revert_kw=share_kw
+ power_kw=power_kw, revert_kw=target_kw
# agents/parent.py: the share of a silent child is given away as well
- max(target_kw - expired_kw, 0.0)
+ target_kw
# agents/standby.py: a standby takes over under the old incarnation
- self.silent, self.incarnation = False, cycle
+ self.silent = False
# agents/loop.py: a standby takes over under the old incarnation
- incarnation = cycle if takes_over else standby.incarnation
+ incarnation = standby.incarnation
# agents/control/impp.py: an inverter that is not heard is never lost
- stale_cycles=last.stale_cycles + 1
+ stale_cycles=last.stale_cycles
# agents/parent.py: a residual of another cycle is used
- if residual is not None and residual.cycle == impp.cycle:
+ if residual is not None:
# agents/loop.py: a late joiner takes its first dispatch for the start of the run
- start_ns = began_ns - cycle * times.timing.cycle_wall_ns
+ start_ns = began_ns
# agents/control/correction.py: the correction has no bound
- HIGHEST_CORRECTION: Final = 0.1
+ HIGHEST_CORRECTION: Final = 9.0
# agents/inputs.py: an expired input is used, and said to be missing
-             found[port] = message
+             found[port] = one.newest
# agents/parent.py: a supervisor follows no setpoint of an earlier cycle
- target_kw = share_kw if setpoint is None else setpoint.power_kw
+ old = setpoint is None or setpoint.cycle < turn.cycle
+         target_kw = share_kw if old else setpoint.power_kw
# sim_plant/inverters.py: a reverted inverter stays limited
- commanded_kw = command.power_kw if self._limits else inf
+ commanded_kw = command.power_kw if self._limits else limit_kw[position]
# agents/control/impp.py: a tripped inverter is counted on
- -METER_TOLERANCE * rating_kw
+ 0.0
# agents/control/impp.py: a tripped inverter is counted on
- return last.stale_cycles > hold_cycles
+ return False
# agents/inputs.py: hold lasts a cycle longer
- if age > self._hold_cycles:
+ if age > self._hold_cycles + 1:
# agents/inputs.py: an old dispatch is accepted for ever
- if age > self._hold_cycles:
+ if age > self._hold_cycles and str(port) != "dispatch":
# agents/parent.py: the correction winds up while the meter is silent
- meter.cycle <= state.meter_cycle
+ meter.cycle < state.meter_cycle
# agents/control/correction.py: the correction goes on while no inverter is curtailed
-     if is_free:
-         return 0.0
# agents/control/allocation.py: the most correlated sibling helps first
- key=row.__getitem__)
+ key=row.__getitem__, reverse=True)
# agents/control/allocation.py: another child than the donor is topped up
-             donor = donors[line]
+             donor = donors[-1 - line]
# agents/parent.py: a setpoint names the donor as the one in need
- self._children[asking].path
+ self._children[donor].path
# sim_plant/inverters.py: an inverter learns its revert value once
- if command.revert_kw is not None and self._revert_is_commanded[position]:
+ if command.revert_kw is not None and self._revert_is_commanded[position] and (
+             self._revert_kw[position] == revert_kw[position]
+         ):
# sim_plant/inverters.py: an old command renews the revert timer
- renewed[position] = max(command.cycle, 0)
+ renewed[position] = cycle
# agents/direct.py: an inverter that is not heard is not probed
-         lost = share_kw is not None and is_lost
+         lost = False and is_lost
# agents/direct.py: old telemetry is taken for new
- if telemetry is not None and 0 <= telemetry.cycle <= state.telemetry_cycle:
+ if telemetry is None:
# agents/parent.py: a report hides how old it is
- stale_cycles = impp.stale_cycles + turn.cycle - impp.cycle
+ stale_cycles = impp.stale_cycles
# agents/dispatch.py: a call for help is not sent
- if residual_kw < 0.0:
+ if False:
# agents/standby.py: a replaced process goes on speaking
-         self.silent = True
+         self.silent = False
# agents/loop.py: a restarted process speaks as the first one
- self.standby.incarnation = cycle
+ self.standby.incarnation = 0
# agents/inputs.py: a parent gives up on its own children between their reports
- age = cycle - message.cycle - one.period + 1
+ age = cycle - message.cycle - one.period + 2
"""
"""For each change of one place: file and bug, the lines that the file has, and what then."""


class Patch(NamedTuple):
    file: str
    old: str
    new: str


def _bugs() -> dict[str, list[Patch]]:
    bugs: dict[str, list[Patch]] = {}
    patches = re.findall(r"# (.*): (.*)\n((?:- .*\n)+)((?:\+ .*\n)*)", _PATCHES)
    for file, bug, *sides in patches:
        old, new = ("\n".join(line[2:] for line in side.splitlines()) for side in sides)
        bugs.setdefault(bug, []).append(Patch(file, old, new))
    return bugs


BUGS: Final = _bugs()

OF_FRACTIONS: Final = frozenset({"a reverted inverter stays limited"})
"""Bugs that show only where commands are a fraction of the maximum, and no limit."""

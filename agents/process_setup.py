"""How a process of a run is set up: its log, its place on the machine, its end."""

from __future__ import annotations

import logging
import signal

from agents.background_log import log_in_background
from agents.kinds import Kind
from agents.machine import take_machine
from agents.parent_death import on_parent_death
from agents.plan import RunPlan

log = logging.getLogger(__name__)


def join_run(attached: bool, death_signal: signal.Signals = signal.SIGKILL) -> None:
    """Set this process up as part of a run: its log, and what it does when its launcher dies.

    Standard input ends with the launcher; but a process that is blocked deep in a library, or
    stopped, would not see it. So the kernel is asked for a signal too, where it can (Linux).

    Parameters
    ----------
    attached
        Whether a launcher started it.
    death_signal
        Sent when the launcher dies.
    """
    logging.basicConfig(format="%(asctime)s %(levelname)s %(message)s", level=logging.INFO)
    # Ctrl-C in a terminal reaches every process of the group: the launcher decides, not we.
    if not attached:
        return
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    on_parent_death(death_signal)


def settle_in(plan: RunPlan, kind: Kind) -> None:
    """Take this process's place on the machine. To be called before it opens the bus.

    The kernel keeps most of it thread by thread, and a thread has it from the one that made it.
    """
    for refusal in take_machine(plan.machine, kind, lockstep=plan.lockstep):
        log.warning("%s", refusal)
    if not plan.lockstep:
        log_in_background()

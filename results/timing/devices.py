"""Devices, measured from outside: what came late or not at all, and whether their stamps are true.

A listener that closed a stage without a device's message names it in `missing`: the message was
late. A stamp is compared with the arrival of the message at the recorder, and with how long the
messages of our own agents take to get there.
"""

from __future__ import annotations

from math import nan
from typing import Final

import msgspec
import numpy as np
import pandas as pd

from agents.plan import RunPlan
from results.timing.stages import LATE, SILENT, sender_of

_LEAST_HOP_MS: Final = 2.0
"""A disagreement below it is none: a hop takes less than 1 ms on a quiet machine."""

MOST_MISSED_PERCENT: Final = 1.0
"""Of a device's answers: as many may be late or missing as cycles of a run may be late."""

_ODD_SHARE: Final = 0.05
"""Of the messages: 1 % of true stamps are beyond the p99 of a hop."""


class DeviceTiming(msgspec.Struct, frozen=True, kw_only=True):
    """What was seen of a device. Counts are of stages in cycles; NaN: nothing to measure.

    stamps_off_ms: The largest disagreement of a stamp, of all but the few that may be chance: above
        0 the device stamped before it sent. hop_p99_ms: What a hop explains.
    findings: In words, each with the first key and cycle.
    """

    agent: str
    expected: int
    late: int
    silent: int
    stamps_off_ms: float
    hop_p99_ms: float
    findings: tuple[str, ...]

    @property
    def is_wrong(self) -> bool:
        """Whether more answers were late or missing than may be, or its stamps are not true."""
        return self.missed_percent > MOST_MISSED_PERCENT or self.stamps_off_ms > self.hop_p99_ms

    @property
    def missed_percent(self) -> float:
        return 100.0 * (self.late + self.silent) / max(self.expected, 1)


def devices_of(table: pd.DataFrame, plan: RunPlan) -> tuple[DeviceTiming, ...]:
    own = (table.arrived - table.published)[~table.device].dropna()
    hop_ms = float(np.quantile(own, 0.99, method="inverted_cdf")) if len(own) else nan
    keys = {place: key for key, place in sender_of(plan).items()}
    table = table.sort_values(["cycle", "order"])
    return tuple(
        _device(agent, table[table.agent == agent], keys, max(hop_ms, _LEAST_HOP_MS))
        for agent in plan.access.external
    )


def _device(
    agent: str, rows: pd.DataFrame, keys: dict[tuple[str, str], str], limit_ms: float
) -> DeviceTiming:
    def first(of: pd.DataFrame) -> str:
        return f"the first: {keys[agent, of.stage.iloc[0]]} of cycle {of.cycle.iloc[0]}"

    findings = []
    late, silent = (int((rows.late == cause).sum()) for cause in (LATE, SILENT))
    if late or silent:
        what = f"{late:,} of {len(rows):,} answers late, {silent:,} missing"
        findings.append(f"{agent}: {what}, {first(rows[rows.late != ''])}")
    off = (rows.arrived - rows.published).dropna()
    odd = off[(off > limit_ms) | (off < 0.0)]
    off_ms = 0.0 if len(off) else nan
    if len(odd) > max(_ODD_SHARE * len(off), 1):
        off_ms, typical = float(odd.abs().max()), float(odd.median())
        when = "before it sends" if typical > 0.0 else "after it has sent"
        findings.append(
            f"{agent} stamps {abs(typical):.0f} ms {when} ({len(odd):,} of {len(off):,} messages, "
            f"{first(rows.loc[odd.index])}; a hop explains {limit_ms:.1f} ms)"
        )
    return DeviceTiming(
        agent=agent,
        expected=len(rows),
        late=late,
        silent=silent,
        stamps_off_ms=off_ms,
        hop_p99_ms=limit_ms,
        findings=tuple(findings),
    )

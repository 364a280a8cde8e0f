"""Properties of a real inverter that cannot be detected: its user states them."""

from __future__ import annotations

from typing import Annotated, Literal

import msgspec
from msgspec import Meta


class DeviceProfile(msgspec.Struct, frozen=True, forbid_unknown_fields=True, kw_only=True):
    """How a real inverter or meter wants to be read and written.

    base_address: First register of its SunSpec map. Default: 40000, 0 or 50000, as found.
    write_function: Modbus function that writes one (6) or several (16) registers. Default: detected
        by the first write.
    block_write: Write a limit in one request, with the registers in between.
    revert: It has a reversion time; without one it holds its last limit for ever.
    limit_step_percent: Step to which it rounds limits, in % of the rating; smaller changes are not
        written. Default: its register's.
    write_every_s: Shortest time between writes of a limit, for registers that wear out [s].
    timeout_s: Time without an answer after which the link is broken [s].
    word_order: Half of a 32-bit number that comes first.
    heartbeat: Count up `ControllerHb` of model 715 every second.
    """

    base_address: Annotated[int, Meta(ge=0, le=65_535)] | None = None
    write_function: Literal[6, 16] | None = None
    block_write: bool = True
    revert: bool = True
    limit_step_percent: Annotated[float, Meta(gt=0.0, le=50.0)] | None = None
    write_every_s: Annotated[float, Meta(ge=0.0, le=3_600.0)] = 0.0
    timeout_s: Annotated[float, Meta(gt=0.0, le=60.0)] = 2.0
    word_order: Literal["high", "low"] = "high"
    heartbeat: bool = False


PLAIN = DeviceProfile()
"""The profile of a device without one."""

"""An operator's program that shares no code with Heliarch: an AGC signal, an order every 4 s.

It follows docs/wire.md ("An operator"); needs `pip install eclipse-zenoh msgpack`.

    heliarch keys oahu
    heliarch launch oahu --pace 1 --secure --external operator --out my-run
    python examples/agc.py --plan my-run/plan.json
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path

import msgpack
from member import Member, read_plan

EVERY_S, HOLD_S = 4.0, 30.0  # After HOLD_S of silence the plant goes back to its schedule.
PERIOD_S = 300.0
LOW, HIGH = 0.2, 0.4  # Of the plant's rating.


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--plan", type=Path, required=True, help="plan.json of the run")
    parser.add_argument("--duration", type=float, default=math.inf, help="simulated time [s]")
    options = parser.parse_args()
    plan = read_plan(options.plan)
    rating_kw = sum(rating_kw for _, rating_kw in plan["inverters"])
    cycle_s = plan["timing"]["cycle_ns"] / 1e9
    operator = Member(plan, "operator", ["recorder", "plant"], [])
    operator.join("dispatch", "run")
    next_s = end_s = -1.0
    while True:
        sample = operator.arrived.get()
        message = msgpack.unpackb(bytes(sample.payload))
        if str(sample.key_expr).endswith("/run"):
            if message["state"] == "stop":
                break
            continue
        operator.cycle = message["cycle"]
        if "operator" in message["order_replaced"]:
            print(f"cycle {operator.cycle}: replaced by an order of {message['order_source']}")
        now_s = operator.cycle * cycle_s
        if operator.cycle < 0 or now_s < next_s:
            continue
        end_s = now_s + options.duration if end_s < 0.0 else end_s
        if now_s >= end_s:
            break
        next_s = now_s + EVERY_S
        wave = (1.0 + math.sin(2.0 * math.pi * now_s / PERIOD_S)) / 2.0
        power_kw = rating_kw * (LOW + (HIGH - LOW) * wave)
        operator.publish("order", power_kw=power_kw, hold_s=HOLD_S, renew_s=2.0 * EVERY_S)
    operator.session.close()


if __name__ == "__main__":
    main()

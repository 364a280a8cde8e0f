"""`heliarch order`: gives an order to a run under way, and says how the plant answers."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

from bus_schemas.errors import InputError
from heliarch.cli.boundary import FAILED, OK
from heliarch.cli.options import Json, Run
from heliarch.cli.output import Output

_POWER = "A power such as 2MW or 1500kW, or the word `schedule`."
_Power = Annotated[str, Parameter(allow_leading_hyphen=True, help=_POWER)]


def order(
    run: Run,
    power: _Power,
    /,
    *,
    ramp: Annotated[str | None, Parameter(metavar="RAMP")] = None,
    hold: Annotated[str | None, Parameter(metavar="TIME")] = None,
    json: Json = None,
) -> int:
    """Order a power from a running plant, or its schedule back.

    Prints at once whether the order is in force, and later how the plant's power settled. Exit
    status 1: the order is not in force, or the power has not settled.

    Example: `heliarch order runs/oahu-20261121-120000-4711 2MW --ramp 500kW/min`

    Parameters
    ----------
    ramp
        Ramp by which the dispatch goes there, such as 500kW/min; default: at once.
    hold
        Time after which the schedule returns, such as 15m; default: the order holds until the next.
    """
    from agents.plan_file import load_plan
    from bus_schemas.tree import ROOT
    from recordings.read.run_file import RECORDING_NAME
    from results.live_answer import LiveAnswer
    from scenarios.powers import parse_power_kw, parse_ramp_kw_per_min
    from scenarios.times import parse_duration_s
    from sim_plant.order_desk import OrderLine
    from sim_plant.orders import COMMAND

    if power == "schedule" and hold is not None:
        raise InputError.of("--hold", "expected a power with it, got schedule")
    folder, output = run.parent if run.name == RECORDING_NAME else run, Output(json)
    if not (folder / "plan.json").exists():
        raise InputError(f"{run}: expected the folder of a run, got none")
    plan = load_plan(folder / "plan.json")
    rating_kw = plan.tree.rating_kw(ROOT)
    asked = {
        "power_kw": None if power == "schedule" else parse_power_kw(power, "order", rating_kw),
        "ramp_kw_per_min": None if ramp is None else parse_ramp_kw_per_min(ramp, "--ramp"),
        "hold_s": None if hold is None else parse_duration_s(hold, "--hold"),
    }
    found = LiveAnswer(plan)
    with OrderLine(folder, plan.timing.cycle_wall_ns / 1e9) as line:
        line.give(COMMAND, **asked)
        for text in found.lines(line.heard()):
            if text:
                output.say(text)
    if found.answer is None:
        return FAILED
    output.write(found.answer)
    return FAILED if found.answer.settling_s is None else OK

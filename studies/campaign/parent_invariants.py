"""What must hold of the decisions of parents: supervisors, and the central controller."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any, Final

from bus_schemas.signals import HELP, IMPP, METER, RESIDUAL, SETPOINT
from bus_schemas.tree import CENTRAL, PLANT, ROOT
from studies.campaign.trace import EXACT, Breaches, Decision, FaultyRun

_MOST_CORRECTION: Final = 0.1


def reports(run: FaultyRun) -> Breaches:
    """Check that IMPP, residual and call for help follow from a share, or from the children."""
    tree = run.plan.tree
    for one in run.decisions:
        report = one.outputs.get(IMPP.of(one.node)) if one.agent != PLANT else None
        share_kw = None if report is None or one.is_doubtful else one.share_kw(one.node)
        if report is None or share_kw is None:
            continue
        children, left_kw = tree.children(one.node), one.outputs[RESIDUAL.of(one.node)].power_kw
        impp_kw, due_kw = report.power_kw, report.power_kw - share_kw
        if children:
            impp_kw = sum(_counts_kw(one, child) for child in children)
            due_kw = sum(_left_kw(one, child) for child in children)
            age = max(_age(run, one, child) for child in children)
            if report.stale_cycles != age:
                text = f"says that its report is {report.stale_cycles} cycles old, not {age}"
                yield one.cycle, f"{one.agent} {text}"
        near_kw = EXACT * tree.rating_kw(ROOT)
        if max(abs(impp_kw - report.power_kw), abs(due_kw - left_kw)) > near_kw:
            text = f"reports {report.power_kw:,.1f} and {left_kw:,.1f} kW"
            yield one.cycle, f"{one.agent} {text}, not {impp_kw:,.1f} and {due_kw:,.1f} kW"
        call = one.outputs.get(HELP.of(one.node))
        if (call.missing_kw if call else 0.0) != max(-left_kw, 0.0):
            yield one.cycle, f"{one.agent} calls for help otherwise than its residual says"


def _age(run: FaultyRun, one: Decision, child: str) -> int:
    """Return how many cycles old a child's measurements are; a silent one's have expired."""
    impp = one.used[IMPP.of(child)]
    if impp is None:
        return run.plan.control.hold_cycles + 1
    return int(impp.stale_cycles) + one.cycle - int(impp.cycle)


def _counts_kw(one: Decision, child: str) -> float:
    """Return what a parent should count on from a child: its IMPP, or its share if it is silent."""
    impp = one.used[IMPP.of(child)]
    return (one.share_kw(child) or 0.0) if impp is None else float(impp.power_kw)


def _left_kw(one: Decision, child: str) -> float:
    """Return what a child has beyond its share: its residual, if that is of its IMPP."""
    impp, residual = one.used[IMPP.of(child)], one.used[RESIDUAL.of(child)]
    if impp is not None and residual is not None and residual.cycle == impp.cycle:
        return float(residual.power_kw)
    return _counts_kw(one, child) - (one.share_kw(child) or 0.0)


def division(run: FaultyRun) -> Breaches:
    """Check that a parent divides its target, or its share without one: all of it, and no more.

    A silent child has its share. No other one gets more than it has, but part of what is lacking.
    """
    for one in run.decisions:
        if one.stage != "solve" or one.is_doubtful or one.share_kw(ROOT) is None:
            continue
        children = run.plan.tree.children(one.node)
        given = [one.outputs.get(SETPOINT.of(child)) for child in children]
        if None not in given:
            yield from ((one.cycle, f"{one.agent} {text}") for text in _wrong_division(run, one))
        elif any(given):
            yield one.cycle, f"{one.agent} has no setpoint for some of its children"


def _wrong_division(run: FaultyRun, one: Decision) -> Iterator[str]:
    tree = run.plan.tree
    near_kw, children = EXACT * tree.rating_kw(one.node), tree.children(one.node)
    given = {child: one.outputs[SETPOINT.of(child)] for child in children}
    silent = [child for child in children if one.used[IMPP.of(child)] is None]
    silent_kw = sum(_counts_kw(one, child) for child in silent)
    impp_kw = sum(_counts_kw(one, child) for child in children) - silent_kw
    given_kw = sum(given[child].power_kw for child in children if child not in silent)
    shared_kw, own_kw = sum(one.share_kw for one in given.values()), one.share_kw(one.node) or 0.0
    target_kw = shared_kw
    if one.agent == CENTRAL:  # What it adds by correction is not published.
        most_kw = _MOST_CORRECTION * tree.rating_kw(ROOT) + near_kw
        if abs(max(own_kw - silent_kw, 0.0) - shared_kw) > most_kw:
            yield f"shares out {shared_kw:,.1f} of {own_kw:,.1f} kW"
    else:
        setpoint = one.used[SETPOINT.of(one.node)]
        wanted_kw = own_kw if setpoint is None else setpoint.power_kw
        target_kw = max(wanted_kw - silent_kw, 0.0)
    floor_kw = run.plan.control.alpha_floor * impp_kw
    if not min(target_kw, impp_kw) - near_kw <= given_kw <= max(target_kw, floor_kw) + near_kw:
        yield f"gives {given_kw:,.1f} kW of {target_kw:,.1f} kW"
    for child, setpoint in given.items():
        beyond_kw = setpoint.power_kw - _counts_kw(one, child)
        if (beyond_kw > near_kw and target_kw < impp_kw - near_kw) or (
            child in silent and abs(beyond_kw) > near_kw
        ):
            yield f"gives {child} {beyond_kw:,.1f} kW beyond what it has"


def help_lines(run: FaultyRun) -> Breaches:
    """Check who helps whom: siblings in the order of their correlation, each with what it has left.

    What is given is accounted for in the setpoint of the donor.
    """
    for one in run.decisions:
        children = run.plan.tree.children(one.node)
        given = [one.outputs.get(SETPOINT.of(child)) for child in children]
        if one.stage != "solve" or one.is_doubtful or one.share_kw(ROOT) is None or None in given:
            continue
        yield from ((one.cycle, f"{one.agent}: {text}") for text in _wrong_help(run, one, given))


def _wrong_help(run: FaultyRun, one: Decision, given: Sequence[Any]) -> Iterator[str]:
    children = run.plan.tree.children(one.node)
    near_kw = EXACT * run.plan.tree.rating_kw(one.node)
    silent = [one.used[IMPP.of(child)] is None for child in children]
    has_kw = [0.0 if silent[n] else _counts_kw(one, child) for n, child in enumerate(children)]
    left_kw = [has - setpoint.share_kw for has, setpoint in zip(has_kw, given, strict=True)]
    gives_kw = [sum(line.power_kw for line in setpoint.help_given) for setpoint in given]
    is_enough = sum(setpoint.share_kw for setpoint in given) < sum(has_kw) - near_kw
    for n, child in enumerate(children):
        if gives_kw[n] > max(left_kw[n], 0.0) + near_kw:
            yield f"{child} gives {gives_kw[n]:,.1f} kW and has {left_kw[n]:,.1f} kW left"
        due_kw = min(given[n].share_kw, has_kw[n]) + gives_kw[n]
        if is_enough and not silent[n] and abs(given[n].power_kw - due_kw) > near_kw:
            yield f"{child} gets {given[n].power_kw:,.1f} kW, not share and help, {due_kw:,.1f} kW"
    has_more = [left_kw[n] - gives_kw[n] > near_kw for n in range(len(children))]
    for n, order in enumerate(_orders(run, one)):
        helps = [
            any(line.needy == children[n] for line in given[donor].help_given) for donor in order
        ]
        for place, donor in enumerate(order):
            if has_more[donor] and any(helps[place + 1 :]):
                yield f"{children[n]} is helped before {children[donor]} has given all it has"
        got_kw = sum(
            line.power_kw
            for setpoint in given
            for line in setpoint.help_given
            if line.needy == children[n]
        )
        if abs(got_kw - max(-left_kw[n], 0.0)) > near_kw and (
            got_kw > max(-left_kw[n], 0.0) or any(has_more)
        ):
            yield f"{children[n]} gets {got_kw:,.1f} kW of help and lacks {-left_kw[n]:,.1f} kW"


def _orders(run: FaultyRun, one: Decision) -> Iterator[list[int]]:
    """Yield for each child the places of its siblings, the least correlated one first."""
    places = range(len(run.plan.tree.children(one.node)))
    now_ns = next(iter(one.outputs.values())).sim_time_ns
    hours = run.plan.control.neighbourhoods_of(one.node)
    holds = [hour.correlation for hour in hours if hour.from_time_ns <= now_ns] or [
        hour.correlation for hour in hours[:1]
    ]
    for place in places:
        row = holds[-1][place] if holds else [0.0] * len(places)
        yield sorted((other for other in places if other != place), key=row.__getitem__)


def correction(run: FaultyRun) -> Breaches:
    """Check that the central controller corrects by new readings of the meter alone.

    While no inverter is curtailed, there is nothing to correct.
    """
    control, rating_kw = run.plan.control, run.plan.tree.rating_kw(ROOT)
    near_kw, last_kw, read, is_new, process = EXACT * rating_kw, 0.0, 0, False, 0
    if control.offset_errors or not control.correction:
        return
    for one in run.decisions:
        if one.agent != CENTRAL:
            continue
        meter, incarnation = one.used[METER.of(ROOT)], next(iter(one.outputs.values())).incarnation
        if meter is not None and meter.cycle > read:
            read, is_new = meter.cycle, True
        given = [one.outputs.get(SETPOINT.of(child)) for child in run.plan.tree.children(ROOT)]
        shares_kw = [setpoint.share_kw for setpoint in given if setpoint is not None]
        own_kw = one.share_kw(ROOT)
        if len(shares_kw) < len(given) or own_kw is None:
            continue
        has_kw = [_counts_kw(one, child) for child in run.plan.tree.children(ROOT)]
        silent = [one.used[IMPP.of(child)] is None for child in run.plan.tree.children(ROOT)]
        silent_kw = sum(kw for kw, is_silent in zip(has_kw, silent, strict=True) if is_silent)
        target_kw = sum(shares_kw) + silent_kw
        # At its bounds the target hides the correction.
        is_shown = silent_kw + near_kw < target_kw < rating_kw - near_kw
        now_kw = target_kw - own_kw - control.offset_kw
        is_judged = is_shown and not one.is_doubtful and incarnation == process
        if is_judged and is_new and own_kw > sum(has_kw) + near_kw and abs(now_kw) > near_kw:
            yield one.cycle, f"central corrects by {now_kw:,.1f} kW, though nothing is curtailed"
        if is_judged and not is_new and abs(now_kw - last_kw) > near_kw:
            yield one.cycle, f"central corrects by {now_kw - last_kw:,.1f} kW without a reading"
        if is_shown:
            last_kw, process = now_kw, incarnation
        elif is_new:
            process = -1  # What it has corrected by is not known.
        is_new = False

"""Real inverters that do not behave as the standard says, read and limited by the gateway."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
from quirky import RATING_W, SUN_W, Quirky, integers, quirky
from running import small_plant
from test_gateway import PLAN, command, eventually, gateway, newest

from agents.device_profile import DeviceProfile
from agents.plan import RunPlan
from scenarios.preparation import prepare
from scenarios.run_options import RunOptions
from scenarios.scenario import load_scenario
from sunspec.client import SunSpecInverter, SunSpecMeter
from sunspec.modbus_tcp import DeviceError, DeviceRefusedError
from sunspec.process import DeviceAccount, read_accounts

SUN_KW = SUN_W / 1e3


def connected(device: Quirky, **profile: Any) -> SunSpecInverter:
    found = SunSpecInverter(device.address, DeviceProfile(**profile))
    found.connect()
    return found


def plan_with(device: Quirky, **profile: Any) -> RunPlan:
    site = msgspec.structs.replace(
        PLAN.site,
        devices=(("c1/a", device.address),),
        profiles=(("c1/a", DeviceProfile(**profile)),),
    )
    return msgspec.structs.replace(PLAN, site=site)


def run(
    device: Quirky, folder: Path, cycles: int = 30, limits: Callable[[int], float] = lambda _: 30.0,
    **profile: Any,
) -> tuple[list[float], list[str], DeviceAccount]:  # fmt: skip
    """Run a gateway for some cycles of 50 ms; return powers read, messages, and its account."""
    powers = []
    folder.mkdir(exist_ok=True)
    with gateway(plan_with(device, **profile), folder) as (devices, messages):
        for cycle in range(cycles):
            devices.command(0, command(cycle, limits(cycle)))
            time.sleep(0.05)
            powers.append(newest(devices).power_kw)
    (account,) = read_accounts(folder)
    return powers, messages, account


# Answers --------------------------------------------------------------------------------------


def another(place: int, value: int) -> Callable[[bytes], bytes]:
    return lambda answer: answer[:place] + bytes([value]) + answer[place + 1 :]


WRONG: dict[str, Callable[[bytes], list[bytes]]] = {
    "twice": lambda answer: [answer, answer],
    "another function": lambda answer: [bytes([4]) + answer[1:]],
    "too short": lambda answer: [answer[:-2]],
    "another count": lambda answer: [another(1, 4)(answer)[:6]],
    "nothing but the function": lambda answer: [answer[:1] + b"\x00"],
}


@pytest.mark.parametrize("echoes", [True, False])
@pytest.mark.parametrize("wrong", WRONG)
def test_an_answer_to_no_request_or_another_one_is_never_a_reading(
    tmp_path: Path, wrong: str, *, echoes: bool
) -> None:
    def answers(number: int, answer: bytes) -> list[bytes]:
        is_wrong = number > 30 and number % 10 == 0 and answer[0] == 3
        return WRONG[wrong](answer) if is_wrong else [answer]

    with quirky(answers=answers, echoes=echoes) as device:
        powers, _, account = run(device, tmp_path, limits=lambda _: 50.0)
    assert set(powers) <= {SUN_KW, 50.0}
    assert account.breaks


@pytest.mark.parametrize("echoes", [True, False])
def test_answers_that_come_one_late_after_exception_11_are_never_readings(
    tmp_path: Path, *, echoes: bool
) -> None:
    kept: list[bytes] = []

    def answers(number: int, answer: bytes) -> list[bytes]:
        if number == 40:
            kept.append(answer)
            return [bytes([answer[0] | 0x80, 11])]
        if number > 40 and kept:
            kept.append(answer)
            return [kept.pop(0)]
        return [answer]

    with quirky(answers=answers, echoes=echoes) as device:
        powers, _, account = run(device, tmp_path, limits=lambda _: 50.0)
    assert set(powers) <= {SUN_KW, 50.0}
    assert account.refused + account.breaks


@pytest.mark.parametrize("request_number", [1, 2, 5, 9])
def test_one_wrong_or_missing_answer_before_the_run_does_not_refuse_it(
    tmp_path: Path, request_number: int
) -> None:
    for number, wrong in enumerate((b"\x83\x0b", b"\x83\x06", b"\x04\x00")):
        spoiled = {request_number: [wrong]}
        with quirky(
            answers=lambda at, answer, spoiled=spoiled: spoiled.get(at, [answer])
        ) as device:
            powers, _, _ = run(device, tmp_path / str(number), cycles=2)
        assert set(powers) <= {SUN_KW, 30.0}


# Links ----------------------------------------------------------------------------------------


def test_a_dropped_link_is_called_so_once_and_counted(tmp_path: Path) -> None:
    with quirky(answers=lambda number, answer: [answer] if number % 10 else []) as device:
        powers, messages, account = run(device, tmp_path, cycles=40)
    assert powers[-1] == 30.0
    assert account.breaks >= 4
    assert sum("connection closed by the device" in message for message in messages) == 1


def test_an_inverter_that_dies_is_named_once_and_counted_as_gone(tmp_path: Path) -> None:
    with quirky() as device, gateway(plan_with(device), tmp_path) as (devices, messages):
        assert newest(devices).power_kw == SUN_KW
        device.__exit__()
        eventually(lambda: devices.expired(1) == {0})
        time.sleep(1.5)
        assert len([message for message in messages if message]) == 1
    (account,) = read_accounts(tmp_path)
    assert account.gone_s is not None


def test_a_cycle_that_is_too_short_for_a_device_is_named_at_the_start(tmp_path: Path) -> None:
    with quirky(slow_s=0.03) as device:
        _, messages, account = run(device, tmp_path, cycles=10)
    (named,) = [message for message in messages if "too short" in message]
    assert "0.05 s" in named
    assert account.late


# Models ---------------------------------------------------------------------------------------

FLOAT = {"St": 4, "W": SUN_W, "A": 1.0, "Hz": 60.0}


def float_models() -> dict[int, dict[str, Any]]:
    models = integers()
    del models[103]
    return models | {113: FLOAT}


@pytest.mark.parametrize("word_order", ["high", "low"])
def test_float_models_are_read_in_either_order_of_words(word_order: str) -> None:
    with quirky(models=float_models(), low_first=word_order == "low") as device:
        assert connected(device, word_order=word_order).read().power_kw == SUN_KW


def test_a_meter_with_floats_is_read() -> None:
    with quirky(models={1: {"Mn": "Acme", "DA": 1}, 213: {"W": 5_000.0}}, power_w=5e3) as device:
        meter = SunSpecMeter(device.address)
        meter.connect()
        assert meter.read().power_kw == 5.0


@pytest.mark.parametrize("first", [0, 40_000, 50_000, 30_000])
def test_the_map_is_found_where_it_is_or_where_the_profile_says(first: int) -> None:
    with quirky(first=first) as device:
        if first == 30_000:
            with pytest.raises(DeviceError, match="base_address"):
                connected(device)
            assert connected(device, base_address=first).read().power_kw == SUN_KW
        else:
            assert connected(device).read().power_kw == SUN_KW


@pytest.mark.parametrize(("state", "available_kw"), [(1, 0.0), (2, 0.0), (8, 0.0)])
def test_a_device_that_sleeps_and_states_no_power_has_none(state: int, available_kw: float) -> None:
    with quirky(models=integers(measured={"St": state}), power_w=None) as device:
        reading = connected(device).read()
    assert (reading.power_kw, reading.available_kw) == (0.0, available_kw)


def test_a_device_at_work_that_states_no_power_is_refused() -> None:
    with quirky(power_w=None) as device, pytest.raises(DeviceRefusedError, match="W in state MPPT"):
        connected(device).read()


# Limits ---------------------------------------------------------------------------------------


def test_a_limit_is_written_in_one_request_with_the_registers_in_between() -> None:
    with quirky() as device:
        connected(device).set_power(30.0, 60.0)
        assert device.writes == [(16, device.register(123, "WMaxLimPct"), 5)]


@pytest.mark.parametrize("refuses", [True, False])
@pytest.mark.parametrize("function", [6, 16])
def test_a_device_with_one_function_to_write_is_limited(
    tmp_path: Path, function: int, *, refuses: bool
) -> None:
    with quirky(functions=frozenset({3, function}), refuses=refuses) as device:
        powers, _, _ = run(device, tmp_path, cycles=40, timeout_s=0.2)
        assert {made for made, _, _ in device.writes} == {function}
    assert powers[-1] == 30.0


def test_a_write_that_fails_is_called_so(tmp_path: Path) -> None:
    with quirky(functions=frozenset({3}), refuses=True) as device:
        _, messages, account = run(device, tmp_path)
    assert any("nothing was written" in message for message in messages)
    assert account.refused


FAMILIES: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    # Writes of several registers are refused, Ena is always 1, and a limit stays for ever.
    "Kostal Plenticore": (
        {
            "models": integers(limits={"WMaxLim_Ena": 1, "WMaxLimPct_RvrtTms": None}),
            "refused": lambda function, point: function == 16 or point != "WMaxLimPct",
        },
        {"write_function": 6, "revert": False},
    ),
    # One register is not written by the function for one register.
    "APsystems ECU-R": ({"functions": frozenset({3, 16})}, {}),
    # With models of curves and DC ports, of any number.
    "IEEE 1547": ({"models": {**integers(), 705: {"NCrv": 0}, 714: {"NPrt": 0}}}, {}),
    # Both functions, and floats unless it is set to whole numbers.
    "Fronius Symo": ({"models": {**integers(), 113: {"W": SUN_W, "St": 4}}}, {}),
}


@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_is_limited_with_the_profile_of_the_document(tmp_path: Path, family: str) -> None:
    quirks, profile = FAMILIES[family]
    with quirky(**quirks) as device:
        powers, messages, account = run(device, tmp_path, **profile)
    assert powers[-1] == 30.0
    assert (account.refused, account.breaks, account.excess_kw) == (0, 0, 0.0)
    assert not any(messages)


def test_a_device_that_is_busy_gets_the_next_command(tmp_path: Path) -> None:
    busy = [0, 0]

    def answers(number: int, answer: bytes) -> list[bytes]:
        if answer[0] == 16 and busy:
            busy.pop()
            return [b"\x90\x06"]
        return [answer]

    with quirky(answers=answers, obeys=True) as device:
        powers, messages, account = run(device, tmp_path)
    assert account.refused == 2
    assert len([message for message in messages if "busy" in message]) == 1
    assert powers[-1] == 30.0
    assert {count for _, _, count in device.writes} == {5}  # Still in one request.


def test_the_profile_of_a_scenario_reaches_the_device_also_at_an_address_of_an_option(
    tmp_path: Path,
) -> None:
    profile = "{ revert = false, limit_step_percent = 1 }"
    address = 'address = "modbus://10.0.0.7/1"'
    table = f'[[devices]]\nnode = "c1/inv01"\n{address}\nprofile = {profile}\n\n'
    path = small_plant(tmp_path / "scenario", ("[irradiance]", f"{table}[irradiance]"))
    options = RunOptions(devices=["c1/inv01=modbus://127.0.0.1:5020/3"])
    site = prepare(load_scenario(path), options, "launch").plan.site
    assert site.devices == (("c1/inv01", "modbus://127.0.0.1:5020/3"),)
    assert site.profile_of("c1/inv01") == DeviceProfile(revert=False, limit_step_percent=1.0)
    assert site.profile_of("c1/inv02") == DeviceProfile()


def test_a_limit_is_only_written_if_it_differs_by_the_step_of_the_register(tmp_path: Path) -> None:
    def limits(cycle: int) -> float:
        return 30.0 + 0.01 * cycle

    with quirky() as device:
        run(device, tmp_path / "fine", limits=limits)
        fine = len(device.writes)
    with quirky() as device:
        run(device, tmp_path / "stated", limits=limits, limit_step_percent=1.0)
        assert len(device.writes) == 1
    with quirky(models=integers(limits={"WMaxLimPct_SF": 0, "WMaxLimPct": 100})) as device:
        run(device, tmp_path / "coarse", limits=limits)
        assert len(device.writes) == 1
    assert fine > 10


def test_without_a_reversion_time_the_key_is_named_and_then_it_works() -> None:
    with quirky(models=integers(limits={"WMaxLimPct_RvrtTms": None})) as device:
        with pytest.raises(DeviceError, match=r"WMaxLimPct_RvrtTms.*revert = false"):
            connected(device)
        found = connected(device, revert=False)
        found.set_power(30.0, 60.0)
        assert found.read().power_kw == 30.0


@pytest.mark.parametrize(
    ("changes", "scale"),
    [
        ({"limits": {"WMaxLimPct_SF": None}}, "WMaxLimPct_SF"),
        ({"measured": {"W_SF": None}}, "W_SF"),
    ],
)
def test_a_scale_factor_that_is_missing_is_named_at_the_start(
    changes: dict[str, Any], scale: str
) -> None:
    served = quirky(models=integers(**changes), obeys=False)
    with served as device, pytest.raises(DeviceError, match=scale):
        connected(device).read()


def test_a_limit_that_is_acknowledged_and_ignored_is_named_with_its_excess(tmp_path: Path) -> None:
    with quirky(obeys=False) as device:
        _, messages, account = run(device, tmp_path)
    assert account.excess_kw == pytest.approx(50.0)
    assert account.has_faults
    assert len([message for message in messages if "50 kW over its limit" in message]) == 1
    with quirky() as device:
        _, _, account = run(device, tmp_path / "obeys", limits=lambda cycle: 30.0 + cycle % 3)
    assert account.excess_kw == 0.0


def test_a_rating_that_does_not_fit_is_named_with_both(tmp_path: Path) -> None:
    models = integers()
    models[120] = {"WRtg_SF": 0, "WRtg": 8_200}
    with quirky(models=models) as device:
        _, messages, _ = run(device, tmp_path, cycles=3)
    assert any("8.2 kW" in message and "100 kW" in message for message in messages)
    assert RATING_W == 1e5


def test_a_heartbeat_is_counted_up_where_it_is_asked_for() -> None:
    models = {**integers(), 715: {"LocRemCtl": 0, "DERHb": 0, "ControllerHb": 0}}
    with quirky(models=models) as device:
        connected(device).read()
        assert not device.writes
        connected(device, heartbeat=True).read()
        assert device.writes == [(16, device.register(715, "ControllerHb"), 2)]


def test_registers_that_wear_out_are_written_no_more_often_than_stated(tmp_path: Path) -> None:
    with quirky() as device:
        run(device, tmp_path, limits=lambda cycle: 30.0 + cycle, write_every_s=0.5)
        assert 2 <= len(device.writes) <= 5

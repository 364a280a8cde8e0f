"""The gateway's client against inverters that lack something, or have one family of models."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator, Sequence
from math import nan

import numpy as np
import pytest

pytest.importorskip("pymodbus")
pytest.importorskip("sunspec2")

from clock_by_hand import ClockByHand

from sunspec.client import DeviceError, SunSpecInverter, SunSpecMeter
from sunspec.limited_inverter import LimitedInverter
from sunspec.registers import Points, inverter_points
from sunspec.server import Sky, served

OLD = (103, 120, 121, 122, 123)
NEW = (701, 702, 704)

Serve = Callable[..., tuple[SunSpecInverter, Sky]]


@pytest.fixture
def clock() -> ClockByHand:
    return ClockByHand()


@pytest.fixture
def serve(clock: ClockByHand) -> Iterator[Serve]:
    """Serve an inverter of 100 kW that could give 80 kW; a client of it, and its sky."""
    contexts = []

    def start(models: Sequence[int], missing: Sequence[str] = ()) -> tuple[SunSpecInverter, Sky]:
        def points(inverter: LimitedInverter, at: float) -> Points:
            return {
                model: {name: value for name, value in found.items() if name not in missing}
                for model, found in inverter_points(inverter, at).items()
                if model in models
            }

        sky = Sky(np.array([[80.0]]), 1.0, None)
        inverters = {"c1/a": LimitedInverter(100.0, sky.available_kw(0))}
        context = served(inverters, sky, lambda: clock() / 1e9, points=points)
        contexts.append(context)
        return SunSpecInverter(context.__enter__()["c1/a"]), sky

    yield start
    for context in contexts:
        context.__exit__(None, None, None)


@pytest.mark.parametrize("models", [OLD, NEW])
def test_each_family_of_models_is_read_and_limited(
    serve: Serve, clock: ClockByHand, models: Sequence[int]
) -> None:
    inverter, _ = serve(models)
    inverter.connect()
    free = inverter.read()
    assert (inverter.rating_kw, free.power_kw, free.limit_kw) == (100.0, 80.0, 100.0)
    assert free.available_kw == 80.0

    inverter.limit(30.0, 60.0, 20.0)
    limited = inverter.read()
    assert (limited.power_kw, limited.limit_kw, inverter.state) == (30.0, 30.0, "THROTTLED")
    # The newer models state no available power: only an inverter that is not throttled shows it.
    stated_kw = 80.0 if models is OLD else nan
    assert limited.available_kw == pytest.approx(stated_kw, nan_ok=True)

    clock.sleep(61.0)
    assert inverter.read().power_kw == (80.0 if models is OLD else 20.0)


@pytest.mark.parametrize("models", [OLD, NEW])
def test_connecting_and_reading_leaves_a_limit_alone(serve: Serve, models: Sequence[int]) -> None:
    inverter, sky = serve(models)
    inverter.connect()
    inverter.limit(40.0, 0.0)
    sky.began_at = None  # The next write would set it.
    another = SunSpecInverter(inverter.address)
    another.connect()
    assert another.read().limit_kw == 40.0
    assert sky.began_at is None


@pytest.mark.parametrize(
    ("models", "without", "named"),
    [
        ((103, 121), (), "704 or 123"),
        ((704, 702), (), "701 or 103"),
        ((103, 123), (), "702"),
        (OLD, ("WMaxLimPct",), "WMaxLimPct in SunSpec model 123"),
    ],
)
def test_a_model_or_point_that_is_missing_is_named(
    serve: Serve, models: Sequence[int], without: Sequence[str], named: str
) -> None:
    inverter, _ = serve(models, without)
    with pytest.raises(DeviceError, match=named):
        inverter.connect()


def test_a_wrong_unit_what_is_no_meter_and_a_port_where_nobody_listens_are_named(
    serve: Serve,
) -> None:
    inverter, _ = serve(OLD)
    wrong = inverter.address.removesuffix("/1") + "/9"
    with pytest.raises(DeviceError, match="unit"):
        SunSpecInverter(wrong).connect()
    with pytest.raises(DeviceError, match="203"):
        SunSpecMeter(inverter.address).connect()
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
    with pytest.raises(DeviceError, match="refused"):
        SunSpecInverter(f"modbus://127.0.0.1:{port}/1").connect()

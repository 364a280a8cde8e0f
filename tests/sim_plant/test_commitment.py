"""The commitment of the plant, and how its settings are written."""

import msgspec
import numpy as np
import pytest

from bus_schemas.errors import InputError
from sim_plant.commitment import (
    CommitmentSettings,
    ConstantCommitment,
    ShareOfClearSky,
    ShareOfMedian,
    commitment_kw,
)

POSSIBLE_KW = np.array([0.0, 100.0, 400.0, 300.0, 200.0])
CLEAR_SKY_KW = np.array([0.0, 200.0, 400.0, 400.0, 200.0])


def read(toml: str) -> CommitmentSettings:
    settings: CommitmentSettings = msgspec.toml.decode(toml, type=CommitmentSettings)
    return settings


def test_constant() -> None:
    settings = read('kind = "constant"\npower_kw = 120.5')
    assert settings == ConstantCommitment(power_kw=120.5)
    np.testing.assert_array_equal(
        commitment_kw(settings, POSSIBLE_KW, CLEAR_SKY_KW), np.full(5, 120.5)
    )


def test_share_of_median_of_the_possible_power() -> None:
    settings = read('kind = "share-of-median"\nshare = 0.8')
    assert settings == ShareOfMedian(share=0.8)
    np.testing.assert_allclose(
        commitment_kw(settings, POSSIBLE_KW, CLEAR_SKY_KW), np.full(5, 160.0)
    )


def test_share_of_clear_sky_follows_the_sun() -> None:
    settings = read('kind = "share-of-clear-sky"\nshare = 0.5')
    assert settings == ShareOfClearSky(share=0.5)
    np.testing.assert_allclose(
        commitment_kw(settings, POSSIBLE_KW, CLEAR_SKY_KW), [0.0, 100.0, 200.0, 200.0, 100.0]
    )


@pytest.mark.parametrize(
    ("toml", "message"),
    [
        ('kind = "constant"\npower_kw = -1.0', "Expected `float` >= 0.0 - at `$.power_kw`"),
        ('kind = "constant"\npower_kw = nan', "Expected `float` >= 0.0 - at `$.power_kw`"),
        ('kind = "share-of-median"\nshare = 0.0', "Expected `float` > 0.0 - at `$.share`"),
        ('kind = "share-of-median"\nshare = -0.5', "Expected `float` > 0.0 - at `$.share`"),
        ('kind = "share-of-clear-sky"\nshare = 1.3', "Expected `float` <= 1.2 - at `$.share`"),
        ('kind = "half"\nshare = 0.5', "Invalid value 'half' - at `$.kind`"),
        ('kind = "constant"\npower_mw = 1.0', "Object contains unknown field `power_mw`"),
    ],
)
def test_settings_out_of_range_are_refused(toml: str, message: str) -> None:
    with pytest.raises(msgspec.ValidationError) as caught:
        read(toml)
    assert str(caught.value) == message


def test_a_share_of_a_run_at_night_is_refused() -> None:
    with pytest.raises(InputError) as caught:
        commitment_kw(ShareOfMedian(share=0.8), np.zeros(5), CLEAR_SKY_KW)
    assert str(caught.value) == (
        "commitment: the median possible power of the run is 0 kW; share-of-median accepts a run"
        " that is in daylight for more than half of its time"
    )


def test_series_of_two_lengths_are_refused() -> None:
    with pytest.raises(ValueError, match=r"not \(5,\) and \(4,\)"):
        commitment_kw(ShareOfClearSky(share=0.5), POSSIBLE_KW, CLEAR_SKY_KW[:4])

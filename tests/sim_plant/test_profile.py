"""The profile of a run: written by the launcher, read by the plant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from bus_schemas.errors import InputError
from sim_plant.profile import Profile, load_profile


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "profile.npz"


def complaint(path: Path) -> str:
    with pytest.raises(InputError) as caught:
        load_profile(path)
    message = str(caught.value)
    assert "\n" not in message
    return message


def test_a_profile_is_read_back_to_the_last_bit(path: Path) -> None:
    profile = Profile(np.array([[1 / 3, 2e-300], [0.0, 470.1]]), np.array([0.1, 1e9]))
    profile.save(path)
    found = load_profile(path)
    assert found.cycles == 2
    np.testing.assert_array_equal(found.mpp_kw, profile.mpp_kw)
    np.testing.assert_array_equal(found.commitment_kw, profile.commitment_kw)


def test_a_profile_that_is_not_there_is_refused(path: Path) -> None:
    assert complaint(path).startswith(f"{path}: expected")


def test_a_folder_is_no_profile(path: Path) -> None:
    path.mkdir()
    assert complaint(path).startswith(f"{path}: expected")


def test_a_file_that_is_no_archive_is_refused(path: Path) -> None:
    path.write_bytes(b"nope")
    found = complaint(path)
    assert found.startswith(f"{path}: ")


def test_an_archive_without_the_commitment_is_refused(path: Path) -> None:
    np.savez_compressed(path, mpp_kw=np.zeros((2, 1)))
    assert complaint(path).startswith(f"{path}: expected")

"""The profile of a run: written by the launcher, read by the plant."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from complaints import complaint_of

from sim_plant.profile import load_profile


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "profile.npz"


def test_what_is_no_profile_is_refused(path: Path) -> None:
    assert complaint_of(load_profile, path).startswith(f"{path}: ")
    path.write_bytes(b"nope")
    assert complaint_of(load_profile, path).startswith(f"{path}: ")
    np.savez_compressed(path, mpp_kw=np.zeros((2, 1)))
    assert complaint_of(load_profile, path).startswith(f"{path}: ")
    path.unlink()
    path.mkdir()
    assert complaint_of(load_profile, path).startswith(f"{path}: ")

"""What a sky brought is kept for the next run, and is never that of another question."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from launch_scripts.run_folder import prepare_run
from scenarios.run_options import RunOptions
from scenarios.scenario import load_scenario
from sim_plant.kept import kept

TIMES = pd.date_range("2010-04-01T22:00Z", periods=3, freq="s", unit="ns")


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "heliarch"


def ask(number: float, times: pd.DatetimeIndex = TIMES) -> tuple[float, bool]:
    """Ask a question; return the first value of its answer, and whether it was worked out."""
    asked = []

    def work_out() -> np.ndarray:
        asked.append(number)
        return np.full(3, number / 3.0)

    return float(kept(times, "a sky", number, work_out=work_out)[0]), bool(asked)


def test_a_question_is_worked_out_once_and_another_one_for_itself(cache: Path) -> None:
    assert [ask(1.0), ask(1.0)] == [(1.0 / 3.0, True), (1.0 / 3.0, False)]
    assert ask(2.0) == (2.0 / 3.0, True)
    assert ask(1.0, TIMES + pd.Timedelta(seconds=1)) == (1.0 / 3.0, True)


def test_a_cache_without_its_folder_only_costs_time(cache: Path) -> None:
    cache.write_text("in its way")
    assert ask(1.0) == (1.0 / 3.0, True)


def test_a_cut_or_a_wrong_byte_anywhere_in_an_answer_only_costs_time(cache: Path) -> None:
    ask(1.0)
    (path,) = cache.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[:-30])
    assert ask(1.0) == (1.0 / 3.0, True)
    for at, byte in enumerate(whole):
        path.write_bytes(whole[:at] + bytes([byte ^ 1]) + whole[at + 1 :])
        assert ask(1.0)[0] == 1.0 / 3.0, f"byte {at}"


def test_the_last_used_entry_is_kept(cache: Path) -> None:
    ask(1.0)
    (first,) = cache.iterdir()
    os.utime(first, (0, 0))
    assert ask(1.0) == (1.0 / 3.0, False)
    for day in range(1, 6):
        large = cache / f"of-day-{day}.npz"
        with large.open("wb") as file:
            file.truncate(56_000_000)
        os.utime(large, (day, day))
    ask(2.0)
    assert not (cache / "of-day-1.npz").exists()
    assert len(list(cache.iterdir())) == 6
    assert [ask(1.0), ask(2.0)] == [(1.0 / 3.0, False), (2.0 / 3.0, False)]


def test_a_run_under_a_known_sky_is_the_same_to_the_last_bit(cache: Path) -> None:
    asked = load_scenario("oahu"), RunOptions(duration="60")
    first, again = (prepare_run(*asked)[0] for _ in range(2))
    assert len(list(cache.iterdir())) >= 2
    assert first.plan.control == again.plan.control
    assert first.profile.mpp_kw.tobytes() == again.profile.mpp_kw.tobytes()
    assert first.profile.commitment_kw.tobytes() == again.profile.commitment_kw.tobytes()

"""Output gets its name when it is complete; otherwise nothing is left of it."""

from __future__ import annotations

from pathlib import Path

import pytest

from bus_schemas.errors import InputError
from recordings.export.unfinished import unfinished


def test_a_file_gets_its_name_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "export.mcap"
    with unfinished(path) as beside:
        beside.write_text("all of it")
        assert not path.exists()
    assert path.read_text() == "all of it"
    assert list(tmp_path.iterdir()) == [path]


def test_a_folder_gets_its_name_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "export"
    with unfinished(path) as beside:
        beside.mkdir()
        (beside / "impp.csv").write_text("all of it")
    assert (path / "impp.csv").read_text() == "all of it"
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("ending", [KeyboardInterrupt, SystemExit, OSError, InputError])
def test_nothing_is_left_of_what_was_interrupted(
    tmp_path: Path, ending: type[BaseException]
) -> None:
    def fail(beside: Path) -> None:
        beside.mkdir()
        (beside / "impp.csv").write_text("half of it")
        raise ending

    with pytest.raises(ending), unfinished(tmp_path / "export") as beside:
        fail(beside)
    assert list(tmp_path.iterdir()) == []


def test_what_exists_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "export.mcap"
    path.write_text("before")
    with pytest.raises(InputError, match="exists already"), unfinished(path):
        pytest.fail("it should not come to this")
    assert path.read_text() == "before"


def test_what_somebody_else_made_meanwhile_is_not_replaced(tmp_path: Path) -> None:
    path = tmp_path / "export.mcap"

    def two_at_once() -> None:
        with unfinished(path) as beside:
            beside.write_text("mine")
            path.write_text("theirs")

    with pytest.raises(InputError, match="exists already"):
        two_at_once()
    assert path.read_text() == "theirs"
    assert list(tmp_path.iterdir()) == [path]


def test_a_place_in_no_folder_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "missing" / "export.mcap"
    with pytest.raises(InputError, match="in an existing folder"), unfinished(path):
        pytest.fail("it should not come to this")

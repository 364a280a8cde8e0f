"""Scenarios in a folder of their own, in which something is changed."""

from __future__ import annotations

from pathlib import Path

from complaints import complaint_of

from scenarios.preparation import Preparation, RunOptions, prepare
from scenarios.scenario import load_scenario


class Folder:
    """A folder with a scenario; its data is there too, or in a folder of its own."""

    def __init__(self, path: Path, text: str, data: Path | None = None) -> None:
        self.path = path
        self.scenario = path / "scenario.toml"
        self.write("scenario.toml", text)
        self._data = data

    def write(self, name: str, text: str) -> None:
        (self.path / name).write_text(text, encoding="utf-8", errors="surrogateescape")

    def change(self, old: str, new: str, name: str = "scenario.toml") -> None:
        text = (self.path / name).read_text(encoding="utf-8")
        assert old in text
        self.write(name, text.replace(old, new))

    def prepare(self, **options: object) -> Preparation:
        scenario = load_scenario(str(self.scenario), self._data)
        return prepare(scenario, RunOptions(**options), "by-hand")  # type: ignore[arg-type]

    def complaint(self, **options: object) -> str:
        return complaint_of(self.prepare, **options)

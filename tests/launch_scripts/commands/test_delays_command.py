"""`heliarch delays`: tables, JSON and page agree."""

from __future__ import annotations

import json
from pathlib import Path

from command_line import done


def test_tables_json_and_page_have_every_run(plant: str, tmp_path: Path) -> None:
    document, page = tmp_path / "delays.json", tmp_path / "delays.html"
    words = ("--duration", "124", "--workers", "2", "--json", document, "--report", page)
    text = done("delays", plant, *words)
    found = json.loads(document.read_bytes())
    outcomes = found["outcomes"]
    # 4 s count: of the central periods they hold two of 1 and two of 2 s.
    assert len(outcomes) == 2 * (9 + 7 + 2)
    assert {one["scheme"] for one in outcomes} == {"paper", "predictive"}
    assert "124 cycles" in found["title"]
    html = page.read_text(encoding="utf-8")
    for one in outcomes:
        mileage = f"{one['figures']['mileage']:,.0f}"
        assert mileage in text
        assert mileage in html
    assert 'id="study-plot"' in html

"""The documents build into a site that needs no network."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path
from xml.etree import ElementTree

from documents import REPOSITORY


def test_the_site_has_no_broken_link_and_nothing_from_the_network(tmp_path: Path) -> None:
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)],
        cwd=REPOSITORY,
        env=os.environ | {"NO_MKDOCS_2_WARNING": "1"},
        text=True,
        capture_output=True,
        check=False,
    )
    assert built.returncode == 0, built.stderr
    pages = list(tmp_path.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        text = page.read_text(encoding="utf-8")
        loaded = re.findall(r'<(?:script|img|iframe)[^>]* src="([^"]+)"', text)
        loaded += re.findall(r'<link rel="(?:stylesheet|preconnect|icon)" href="([^"]+)"', text)
        assert [url for url in loaded if url.startswith(("http:", "https:", "//"))] == [], page
        assert 'class="mermaid"' not in text, f"{page}: Mermaid diagrams load a script"
    for picture in tmp_path.rglob("images/*.svg"):
        ElementTree.parse(picture)
    metrics = (tmp_path / "metrics.html").read_text(encoding="utf-8")
    assert 'class="arithmatex"' in metrics
    assert "$\\sum" not in metrics, "a formula stands there as LaTeX"

"""Measures the tables of the documents: `make results DATA=FOLDER`.

    python docs/measured [DATA] [PAGE...]

Each table stands between `<!-- measured: NAME -->` and `<!-- end -->`. DATA holds the measurements
in folders of their own; without it, tables that rest on them stay as they are. With pages, such as
clusters.md, only theirs are measured.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import Final

import clouds
import clusters
import delays
import regulation
import results
from tables import Tables, write_table

FROM_SYNTHETIC: Final[dict[str, Tables]] = {
    "results.md": results.FROM_SYNTHETIC,
    "clusters.md": clusters.FROM_SYNTHETIC,
    "delays.md": delays.TABLES,
}
FROM_DATA: Final[dict[str, Tables]] = {
    "results.md": results.FROM_DATA,
    "clusters.md": clusters.FROM_DATA,
    "clouds.md": clouds.TABLES,
    "metrics.md": regulation.TABLES,
}


def main() -> None:
    """Measure the tables, and write each into its document when it is done."""
    pages = [word for word in sys.argv[1:] if word.endswith(".md")]
    data = next((Path(word) for word in sys.argv[1:] if word not in pages), None)
    began = time.monotonic()
    for page in pages or dict.fromkeys((*FROM_SYNTHETIC, *FROM_DATA)):
        tables = FROM_SYNTHETIC.get(page, {}) | (FROM_DATA.get(page, {}) if data else {})
        for name, write in tables.items():
            start = time.monotonic()
            write_table(page, name, write(data or Path()))
            print(f"{page}, {name}: {time.monotonic() - start:.0f} s", flush=True)
    print(f"{(time.monotonic() - began) / 60.0:.0f} min in all")


if __name__ == "__main__":
    main()

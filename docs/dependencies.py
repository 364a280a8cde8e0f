"""Lists what Heliarch depends on: `make sbom`.

Writes `build/sbom.json` (CycloneDX 1.5) and the tables of licences.md, from the packages that are
installed in the environment: names, versions and licences as the packages state them.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from importlib.metadata import Distribution, PackageNotFoundError, distribution
from pathlib import Path
from typing import Any, Final

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from docs.shown import fill, write

SBOM: Final = Path(__file__).parent.parent / "build" / "sbom.json"
CLASSIFIER: Final = "License :: OSI Approved :: "


def closure(name: str, extras: frozenset[str], found: dict[str, Distribution]) -> None:
    """Add all that a package needs with these extras, on this machine."""
    for line in distribution(name).requires or ():
        needed = Requirement(line)
        asked = needed.marker is None or any(
            needed.marker.evaluate({"extra": extra}) for extra in extras | {""}
        )
        key = canonicalize_name(needed.name)
        if asked and key not in found:
            try:
                found[key] = distribution(needed.name)
            except PackageNotFoundError:
                raise SystemExit(f"{needed.name}, which {name} needs, is not installed") from None
            closure(needed.name, frozenset(needed.extras), found)


def with_extras(*extras: str) -> dict[str, Distribution]:
    found: dict[str, Distribution] = {}
    closure("heliarch", frozenset(extras), found)
    return found


def licence(package: Distribution) -> str:
    """Return what a package states: an SPDX expression, else a classifier, else its first line."""
    stated = package.metadata
    if expression := stated.get("License-Expression"):
        return expression
    classes = [line for line in stated.get_all("Classifier") or () if line.startswith(CLASSIFIER)]
    if classes:
        return ", ".join(line.removeprefix(CLASSIFIER) for line in classes)
    return (stated.get("License") or "not stated").strip().splitlines()[0]


def size_mb(packages: dict[str, Distribution]) -> float:
    files = (file for package in packages.values() for file in package.files or ())
    paths = (Path(str(file.locate())) for file in files)
    return sum(path.stat().st_size for path in paths if path.is_file()) / 1e6


def component(name: str, package: Distribution) -> dict[str, Any]:
    return {
        "type": "library",
        "name": name,
        "version": package.version,
        "purl": f"pkg:pypi/{name}@{package.version}",
        "licenses": [{"license": {"name": licence(package)}}],
    }


def dependencies(packages: dict[str, dict[str, Distribution]]) -> Iterator[tuple[str, ...]]:
    yield "package", "version", "licence", "needed by"
    every = {name: package for found in packages.values() for name, package in found.items()}
    for name, package in sorted(every.items()):
        base = name in packages["-"]
        users = [extra for extra, found in packages.items() if name in found]
        yield name, package.version, licence(package), "all" if base else ", ".join(users)


def sizes(packages: dict[str, dict[str, Distribution]]) -> Iterator[tuple[str, ...]]:
    yield "extra", "packages", "MB"
    for extra, found in packages.items():
        yield extra, str(len(found)), f"{size_mb(found):.0f}"


def main() -> None:
    extras = distribution("heliarch").metadata.get_all("Provides-Extra") or []
    # The scheduler of Dask is no part of `dev`, so it may be absent.
    listed = [extra for extra in extras if extra not in ("cluster", "dev")]
    packages = {"-": with_extras(), **{extra: with_extras(extra) for extra in listed}}
    write("licences-dependencies", dependencies(packages))
    write("licences-sizes", sizes(packages))
    fill()
    every = {name: package for found in packages.values() for name, package in found.items()}
    document = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.5",
        "version": 1,
        "metadata": {"component": component("heliarch", distribution("heliarch"))},
        "components": [component(*entry) for entry in sorted(every.items())],
    }
    SBOM.parent.mkdir(exist_ok=True)
    SBOM.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    print(f"{SBOM}: {len(every)} packages")


if __name__ == "__main__":
    main()

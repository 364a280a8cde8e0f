"""Whether Heliarch's modules are its own: another package may have put its files in their place."""

from __future__ import annotations

from base64 import urlsafe_b64encode
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, distribution, packages_distributions
from importlib.util import find_spec
from pathlib import Path
from typing import Final

_FOLDER: Final = Path(__file__).parent.parent
_PACKAGES: Final = (
    *("agents", "bus_schemas", "launch_scripts", "live_page", "recordings", "results", "scenarios"),
    *("sim_plant", "studies", "sunspec"),
)


def replaced_module() -> str:
    """Say which module is another package's, and what to do; empty: all are Heliarch's."""
    for name in _PACKAGES:
        spec = find_spec(name)
        own = _FOLDER / name / "__init__.py"
        if spec is None or spec.origin != str(own) or _is_changed(own):
            others = ", ".join(set(packages_distributions().get(name, ())) - {"heliarch"})
            return (
                f"the module {name} is not Heliarch's, but that of {others or 'another package'}: "
                "install Heliarch in an environment of its own, for instance with pipx"
            )
    return ""


def _is_changed(path: Path) -> bool:
    """Whether a file is another than the one that was installed."""
    try:
        files = distribution("heliarch").files or ()
    except PackageNotFoundError:  # It runs from a checkout.
        return False
    installed = {file.locate(): file.hash for file in files if file.name == path.name}
    known = installed.get(path)
    digest = urlsafe_b64encode(sha256(path.read_bytes()).digest()).decode().rstrip("=")
    return known is not None and known.value != digest

"""Where every command begins and ends."""

from __future__ import annotations

import time
from typing import Final

BEGAN_AT: Final = time.monotonic()
"""When the program was started [s]."""

"""What Python users need: load a scenario, simulate it, open a recording, compare schemes."""

from recordings import open_run

__all__ = ["open_run"]

"""SunSpec models with the points that are there once; curves, ports and the like are left out."""

from __future__ import annotations

from sunspec2.device import Model, get_model_def
from sunspec2.mdef import ModelDefinitionError


def sunspec_model(number: int) -> Model:
    """Return a model by its number; one that is unknown has no points.

    pysunspec2 refuses to make one that has groups without the number of their members.
    """
    try:
        groups = get_model_def(number)["group"].get("groups", ())
    except ModelDefinitionError:
        groups = ()
    return Model(number, data={group["count"]: 0 for group in groups if "count" in group})

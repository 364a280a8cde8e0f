"""Compiles plain functions with Numba, together with the functions that they call."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType
from typing import Final, ParamSpec, TypeGuard, TypeVar, cast

from numba import njit

import agents.control
import sim_plant.inverters
import studies.arrays

P = ParamSpec("P")
R = TypeVar("R")

_MODULES: Final = ("agents.control.", "studies.arrays.", "sim_plant.inverters")


def compiled(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function compiled by Numba, as are all functions of ours that it calls.

    The function itself stays plain Python: a copy of it sees compiled functions where the original
    sees plain ones. Numba keeps the compiled code on disk, under a name that changes with our
    sources.
    """
    digest, folders = sha256(), [Path(one.__path__[0]) for one in (agents.control, studies.arrays)]
    files = [file for folder in folders for file in sorted(folder.glob("*.py"))]
    for file in (*files, Path(sim_plant.inverters.__file__)):
        digest.update(file.read_bytes())
    name = digest.hexdigest()[:16]
    copy = _copy(cast(FunctionType, function), name, {})
    try:
        return cast(Callable[P, R], njit(cache=True)(copy))
    except RuntimeError:  # Nothing can be written, as in a container without a home.
        return cast(Callable[P, R], njit(copy))


def _is_ours(used: object) -> TypeGuard[FunctionType]:
    return isinstance(used, FunctionType) and used.__module__.startswith(_MODULES)


def _copy(function: FunctionType, name: str, known: dict[object, object]) -> FunctionType:
    seen = dict(function.__globals__)
    for used in _names(function.__code__):
        callee = seen.get(used)
        if _is_ours(callee):
            if callee not in known:
                known[callee] = njit(_copy(callee, name, known))
            seen[used] = known[callee]
    copy = FunctionType(function.__code__, seen, function.__name__)
    # Numba names machine code after this. Of two versions with one name, one would run as both.
    copy.__qualname__ += f"_{name}"
    return copy


def _names(code: CodeType) -> Iterator[str]:
    """Yield the names that a function uses, also within its comprehensions."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)

"""Compiles plain functions with Numba, together with the functions that they call."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from hashlib import sha256
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any, Final, ParamSpec, TypeVar, cast

from numba import njit

P = ParamSpec("P")
R = TypeVar("R")

_PACKAGES: Final = ("agents.control.", "launch_scripts.study.")


def compiled(
    function: Callable[P, R], constants: Mapping[str, float] | None = None
) -> Callable[P, R]:
    """Return a function compiled by Numba, as are all functions of ours that it calls.

    The function itself stays plain Python: a copy of it sees compiled functions where the original
    sees plain ones. Numba keeps the compiled code on disk, under a name that changes with the
    sources of all these functions and with the constants.

    Parameters
    ----------
    function
        A module-level function of `agents.control` or of the study.
    constants
        Values in place of the module constants of these names, wherever they are used.
    """
    constants = constants or {}
    plain = cast(FunctionType, function)
    callees: dict[FunctionType, Any] = {}
    copy = _copy(plain, constants, callees)
    copy.__qualname__ += f"_{_digest((plain, *callees), constants)}"
    return cast(Callable[P, R], njit(cache=True)(copy))


def _copy(
    function: FunctionType, constants: Mapping[str, float], callees: dict[FunctionType, Any]
) -> FunctionType:
    seen = dict(function.__globals__)
    for name in _names(function.__code__):
        used = seen.get(name)
        if name in constants and name in seen:
            seen[name] = constants[name]
        elif isinstance(used, FunctionType) and used.__module__.startswith(_PACKAGES):
            if used not in callees:
                callees[used] = njit(_copy(used, constants, callees))
            seen[name] = callees[used]
    return FunctionType(function.__code__, seen, function.__name__)


def _names(code: CodeType) -> Iterator[str]:
    """Yield the names that a function uses, also within its comprehensions."""
    yield from code.co_names
    for constant in code.co_consts:
        if isinstance(constant, CodeType):
            yield from _names(constant)


def _digest(functions: tuple[FunctionType, ...], constants: Mapping[str, float]) -> str:
    """Return a name for the sources of all modules that a function or a constant comes from."""
    found = sha256(repr(sorted(constants.items())).encode())
    for file in sorted({function.__code__.co_filename for function in functions}):
        found.update(Path(file).read_bytes())
    return found.hexdigest()[:16]

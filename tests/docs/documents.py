"""The documents as tests read them: their code blocks, and the commands in these.

An HTML comment before a block says what a reader does not need to see:
`<!-- not run: REASON -->` (the block is only parsed), `<!-- may fail: REASON -->` (its exit status
depends on the machine) and, before an output, `<!-- varies: REASON -->` (it is not compared).
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

REPOSITORY = Path(__file__).parents[2]
DOCUMENTS = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "examples/*.md")
    for path in REPOSITORY.glob(pattern)
    if path.name != "CHANGELOG.md"
)

_FENCE = re.compile(
    r"(?:^<!-- (?P<mark>not run|may fail|varies): (?P<reason>[^\n]+) -->\n\n?)?"
    r"^```(?P<head>[^\n]*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
_INLINE = re.compile(r"`(heliarch [^`]+)`")


@dataclass(frozen=True)
class Block:
    """One fenced block."""

    language: str
    title: str
    text: str
    mark: str

    @property
    def commands(self) -> str:
        """The Python or shell text that does what the block says; empty where that is none."""
        if self.language == "console":
            return _prompted(self.text)
        return self.text if self.language in {"sh", "python"} else ""

    @property
    def output(self) -> list[str]:
        """The lines that its commands print, or that are the output of the block before it."""
        if self.language not in {"console", "text"} or self.mark == "varies" or self.title:
            return []
        lines = [line for line in self.text.splitlines() if line.strip() not in {"", "[...]"}]
        return [line for line in lines if not line.startswith(("$ ", "    --"))]


def blocks_of(document: Path) -> list[Block]:
    """Return the fenced blocks of a document, in order."""
    found = []
    for match in _FENCE.finditer(document.read_text(encoding="utf-8")):
        language, _, rest = match["head"].partition(" ")
        title = re.search(r'title="([^"]+)"', rest)
        found.append(Block(language, title[1] if title else "", match["text"], match["mark"] or ""))
    return found


def heliarch_lines(document: Path) -> Iterator[tuple[str, bool]]:
    """Return each `heliarch` command anywhere in a document, and whether it stands in prose."""
    text = document.read_text(encoding="utf-8")
    without_fences = _FENCE.sub("", text)
    code = "\n".join(
        [*(block.commands for block in blocks_of(document)), _indented_code(without_fences)]
    )
    for line in code.replace("\\\n", " ").splitlines():
        command = re.match(r"\s*(?:\$ )?(?:\.venv/bin/)?(heliarch .*)", line)
        if command:
            yield command[1], False
    for command in _INLINE.finditer(without_fences):
        yield " ".join(command[1].split()), True


def words_of(command: str) -> list[str]:
    """Return the arguments of one command line, without comment and redirection."""
    words = shlex.split(command, comments=True)[1:]
    for end, word in enumerate(words):
        if word in {"&", "&&", "|", ">", "||"}:
            return words[:end]
    return words


def _prompted(text: str) -> str:
    """Return the commands of a console block: lines after `$ `, with those that continue them."""
    commands, continued = [], False
    for line in text.splitlines():
        if continued or line.startswith("$ "):
            commands.append(line if continued else line[2:])
            continued = line.endswith("\\")
    return "\n".join(commands) + "\n"


def _indented_code(text: str) -> str:
    return "\n".join(line[4:] for line in text.splitlines() if line.startswith("    "))

"""Reads a report as a browser would: its elements, and the data of its figures as numbers."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from html.parser import HTMLParser
from typing import Any

import numpy as np
from numpy.typing import NDArray

_VOID = {"meta", "link", "img", "br", "hr", "input"}


@dataclass
class Element:
    """One element: its tag, its attributes and the text directly in it."""

    tag: str
    attributes: dict[str, str | None]
    text: str = ""


@dataclass
class Page(HTMLParser):
    """A parsed page; its elements must close in the order in which they were opened."""

    elements: list[Element] = field(default_factory=list)
    open: list[Element] = field(default_factory=list)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        element = Element(tag, dict(attrs))
        self.elements.append(element)
        if tag not in _VOID:
            self.open.append(element)

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop().tag == tag

    def handle_data(self, data: str) -> None:
        if self.open:
            self.open[-1].text += data

    def of(self, tag: str) -> list[Element]:
        """All elements with a tag."""
        return [element for element in self.elements if element.tag == tag]

    def texts(self, tag: str) -> list[str]:
        """Text of all elements with a tag."""
        return [element.text for element in self.of(tag)]

    def figure(self, anchor: str) -> dict[str, Any]:
        """Plotly's data and layout of the figure at an anchor."""
        (found,) = [e for e in self.elements if e.attributes.get("id") == f"{anchor}-plot-data"]
        figure: dict[str, Any] = json.loads(found.text)
        return figure

    def figures(self) -> list[str]:
        """Anchors of all figures, in their order."""
        plots = [e for e in self.of("div") if e.attributes.get("class") == "plot"]
        return [str(plot.attributes["id"]).removesuffix("-plot") for plot in plots]

    def trace(self, anchor: str, name: str) -> dict[str, Any]:
        """The first trace of a name in a figure."""
        return next(t for t in self.figure(anchor)["data"] if t.get("name") == name)


def read_page(text: str) -> Page:
    """Parse a page to its end."""
    page = Page()
    page.feed(text)
    page.close()
    assert page.open == []
    return page


def numbers(array: dict[str, str] | list[float]) -> NDArray[np.float64]:
    """An array of a Plotly figure, be it a list or packed."""
    if isinstance(array, dict):
        flat = np.frombuffer(base64.b64decode(array["bdata"]), dtype=array["dtype"])
        if "shape" in array:
            return flat.reshape([int(n) for n in array["shape"].split(",")]).astype(np.float64)
        return flat.astype(np.float64)
    return np.array(array, dtype=np.float64)

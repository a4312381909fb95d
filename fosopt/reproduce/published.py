"""The numbers printed in [Barker1991], in the digits of the print."""

from __future__ import annotations

import tomllib
from importlib.resources import files
from typing import Any, Self


class Printed(float):
    """A number that remembers how it was printed, such as ``50.000``.

    Attributes
    ----------
    text
        As printed.
    """

    text: str

    def __new__(cls, text: str) -> Self:  # noqa: D102
        self = super().__new__(cls, text)
        self.text = text
        return self


PUBLISHED: dict[str, Any] = tomllib.loads(
    (files("fosopt.reproduce") / "published.toml").read_text(encoding="utf-8"), parse_float=Printed
)
"""Printed numbers and statements by the table, section or chapter they stand in."""

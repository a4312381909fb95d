"""Study files and what is done with them.

Names are imported when they are first used, so that importing the package costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from fosopt.study.describe import describe_study
    from fosopt.study.load import dump_study, load_study, parse_study
    from fosopt.study.schema import Study
    from fosopt.study.template import TEMPLATE

__all__ = ["TEMPLATE", "Study", "describe_study", "dump_study", "load_study", "parse_study"]

_HOMES = {
    "Study": "schema",
    "TEMPLATE": "template",
    "describe_study": "describe",
    "dump_study": "load",
    "load_study": "load",
    "parse_study": "load",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)

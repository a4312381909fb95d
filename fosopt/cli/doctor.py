"""The command that looks at the machine before a long run does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from fosopt.cli.guard import Code, guarded, say


@guarded
def doctor(
    directory: Annotated[
        Path, typer.Argument(metavar="DIR", help="Where runs will be written.", show_default=False)
    ] = Path(),
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON.")] = False,
) -> None:
    """Check versions, solvers, threads, workers and the file system. Exit code 4 if something is wrong."""
    from fosopt.study.doctor import examine

    found = examine(directory)
    if as_json:
        say(json.dumps([vars(each) for each in found], allow_nan=False))
    else:
        width = max(len(each.what) for each in found)
        for each in found:
            say(f"{'ok  ' if each.good else 'BAD '} {each.what:<{width}}  {each.found}")
    raise typer.Exit(Code.DONE if all(each.good for each in found) else Code.UNVERIFIED)

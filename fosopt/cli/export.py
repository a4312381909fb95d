"""The command that writes a run, or one design of it, for other programs."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from fosopt.cli.guard import guarded, say

if TYPE_CHECKING:
    from fosopt.study.chosen import ChosenDesign
    from fosopt.study.store import Store

HELP = """Write the points of a run, or one design, for other programs.

csv, json, mat, parquet and netcdf hold all points of a run or a sweep. plant (matrices of plant, controller and closed
loop for MATLAB), members (tables of the truss) and nastran (a bulk data deck) hold one design: a point of a run, chosen
with --point, or that of a study file, such as designs/003.yaml of a run. The run may be going on, or have been killed.
docs/exports.md lists columns, signals and units.
"""


class Format(StrEnum):
    """Files that a run or a design is exported to."""

    CSV = "csv"
    JSON = "json"
    MAT = "mat"
    PARQUET = "parquet"
    NETCDF = "netcdf"
    PLANT = "plant"
    MEMBERS = "members"
    NASTRAN = "nastran"


_ENDS = {Format.NETCDF: "nc", Format.PLANT: "mat", Format.MEMBERS: "csv", Format.NASTRAN: "bdf"}
_OF_ONE_DESIGN = (Format.PLANT, Format.MEMBERS, Format.NASTRAN)
_RECORD = b"SQLite format 3\0"


@guarded
def export(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="RUN", help="The directory of a run, or its run.sqlite; for one design also a study file."
        ),
    ],
    target: Annotated[Format, typer.Option("--format", help="What to write.")],
    key: Annotated[
        str | None,
        typer.Option(
            "--point",
            metavar="KEY",
            help="Key of the point whose design is wanted, as in front.csv, or its number in a sweep.",
            show_default=False,
        ),
    ] = None,
    rate: Annotated[
        str | None,
        typer.Option(
            metavar="FREQUENCY",
            help="Also discretize the loop of 'plant' at this rate, such as 2kHz; default as the study samples it.",
            show_default=False,
        ),
    ] = None,
    delay: Annotated[
        str | None,
        typer.Option(
            metavar="TIME",
            help="Computation delay of the discretized loop, such as 0.2ms; default that of the study, or none.",
            show_default=False,
        ),
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="The file to write; default front.csv, sweep.nc, 003-plant.mat and the like, beside the record or "
            "the study file.",
            show_default=False,
        ),
    ] = None,
) -> None:
    """Write the points of a run, or one design, for other programs."""
    if target is not Format.PLANT and (rate is not None or delay is not None):
        raise typer.BadParameter(
            f"--rate and --delay discretize a plant; remove them, or write --format {Format.PLANT}"
        )
    if target not in _OF_ONE_DESIGN:
        if key is not None:
            designs = ", ".join(_OF_ONE_DESIGN)
            raise typer.BadParameter(
                f"'{target}' holds all points; remove --point, or choose one of {designs}"
            )
        written = [_points(source, target, out)]
    else:
        written = _design(source, target, key, rate, delay, out)
    for path in written:
        say(f"wrote {path}")


def _points(source: Path, target: Format, out: Path | None) -> Path:
    """Write all points of a run."""
    from fosopt import export as writers
    from fosopt.study.resume import record_of
    from fosopt.study.store import Store

    record = record_of(source)
    with Store.open(record) as store:
        if store.header()["kind"] == "sweep":
            path = _place(record.with_name(f"sweep.{_end(target)}"), out, record)
            _sweep(store, target, path)
            return path
        data = store.run()
    path = _place(record.with_name(f"front.{_end(target)}"), out, record)
    write = {
        Format.CSV: writers.write_csv,
        Format.JSON: writers.write_json,
        Format.MAT: writers.write_mat,
        Format.PARQUET: writers.write_parquet,
        Format.NETCDF: writers.write_netcdf,
    }
    write[target](data, path)
    return path


def _sweep(store: Store, target: Format, path: Path) -> None:
    from fosopt.errors import FosoptError
    from fosopt.export.sweep import write_sweep_csv, write_sweep_parquet
    from fosopt.export.sweep_matlab import write_sweep_mat
    from fosopt.export.sweep_netcdf import write_sweep_netcdf
    from fosopt.study.sweep_export import recorded_sweep

    if target is Format.JSON:
        raise FosoptError(
            "a sweep has too many points for JSON; write csv, parquet, mat or netcdf, and read sweep.json in the "
            "directory of the run for what it is"
        )
    write = {
        Format.CSV: write_sweep_csv,
        Format.MAT: write_sweep_mat,
        Format.PARQUET: write_sweep_parquet,
        Format.NETCDF: write_sweep_netcdf,
    }
    write[target](recorded_sweep(store), path)


def _design(
    source: Path, target: Format, key: str | None, rate: str | None, delay: str | None, out: Path | None
) -> list[Path]:
    """Write one design."""
    from fosopt.export.columns import provenance_of
    from fosopt.export.truss import write_deck, write_members

    sampling = _quantity("--rate", rate, "frequency"), _quantity("--delay", delay, "time")
    chosen, place = _chosen(source, key)
    path = _place(place.with_name(f"{chosen.key}-{target}.{_end(target)}"), out, place)
    if target is Format.PLANT:
        period = None if sampling[0] is None else _period(sampling[0])
        for note in chosen.write_plant(path, period, sampling[1]):
            say(f"note: {note}", error=True)
        return [path]
    if chosen.doubt is not None:
        say(f"note: point {chosen.key} is not verified: {chosen.doubt}", error=True)
    if target is Format.MEMBERS:
        return write_members(chosen.truss, provenance_of({"provenance": chosen.origin}), path)
    write_deck(chosen.truss, chosen.label, chosen.origin, path)
    return [path]


def _chosen(source: Path, key: str | None) -> tuple[ChosenDesign, Path]:
    """The design, and the file it comes from."""
    from fosopt.study.chosen import design_of_file, design_of_run
    from fosopt.study.resume import record_of

    record = record_of(source)
    if source.is_dir() or not record.is_file() or _starts_as_record(record):
        return design_of_run(record, key), record
    if key is not None:
        raise typer.BadParameter(
            "a study file has one design; remove --point, or give the directory of a run"
        )
    return design_of_file(source), source


def _starts_as_record(path: Path) -> bool:
    with path.open("rb") as stream:
        return stream.read(len(_RECORD)) == _RECORD


def _quantity(option: str, text: str | None, dimension: str) -> float | None:
    from fosopt.units import QuantityError, parse_quantity

    if text is None:
        return None
    try:
        return parse_quantity(text, dimension)
    except QuantityError as error:
        raise typer.BadParameter(f"{option}: {error}") from None


def _period(rate: float) -> float:
    """Period of a rate in rad/s [s]."""
    from math import pi

    if not rate > 0:
        raise typer.BadParameter("--rate: a rate of zero or less samples nothing; give one such as 2kHz")
    return 2 * pi / rate


def _end(target: Format) -> str:
    return _ENDS.get(target, target.value)


def _place(default: Path, out: Path | None, source: Path) -> Path:
    """Where to write, which is never what is read."""
    if out is not None and out.exists() and out.samefile(source):
        raise typer.BadParameter(f"--out {out} is what is exported; give another file")
    return default if out is None else out

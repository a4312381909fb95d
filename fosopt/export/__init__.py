"""A run or a design as files for other tools."""

from fosopt.export.matlab import write_mat
from fosopt.export.netcdf import write_netcdf
from fosopt.export.parquet import write_parquet
from fosopt.export.text import write_csv, write_json
from fosopt.export.writing import ExportError

__all__ = ["ExportError", "write_csv", "write_json", "write_mat", "write_netcdf", "write_parquet"]

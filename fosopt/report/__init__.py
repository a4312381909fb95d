"""The report of a run: one self-contained HTML file that opens without a network."""

from fosopt.report.html import write_report
from fosopt.report.sweep import write_sweep_report

__all__ = ["write_report", "write_sweep_report"]

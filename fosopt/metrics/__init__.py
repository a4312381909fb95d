"""Metrics of a flexible optical system, each with its exact differential."""

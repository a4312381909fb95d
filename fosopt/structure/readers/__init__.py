"""Readers of foreign models, one format to a file: modal sets, matrices, bulk data and tables of members."""

"""Readers of tables: CSV, Parquet, HDF5, MATLAB, and the rules by which columns are interpreted."""

"""Results out: report.json, report.md, tables, tracks, and the run directory that appears when it is complete."""

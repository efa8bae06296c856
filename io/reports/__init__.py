"""Results out: report.json, report.md, tables, tracks, the run directory."""

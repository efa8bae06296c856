"""Where the checkout keeps what tests read."""

from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SAMPLES = ROOT / "sample_logs"
FIELD_CONFIGURATIONS = ROOT / "benchmarks" / "field"

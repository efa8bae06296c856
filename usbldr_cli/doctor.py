"""``usbldr doctor``: faults of a log that matter for navigation."""

import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from usbldr.filters.errors import CheckError, printable
from usbldr_cli.options.log_options import log_options, read_request
from usbldr_cli.options.verbosity import verbose_option

if TYPE_CHECKING:
    from usbldr.io.doctor.doctor import Examination


@click.command()
@log_options
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@verbose_option
def doctor(log: str, as_json: bool, **selection: Any) -> int:
    """Find faults in LOG that matter for navigation, and say what to do.

    Checks sensors, clocks, gaps and outliers, and tests the conventions of axes, heading and map against the data. Each
    finding has a stable code, which docs/findings.md explains. Exit code 1 if one of them is an error.

    \b
    $ usbldr doctor dive.mcap
    """
    from usbldr.io.doctor.doctor import examine, examine_log
    from usbldr.io.session import is_simulated, open_log

    request = read_request(**selection)
    found = examine_log(open_log(log, request)) if is_simulated(log) else examine(Path(log), request)
    click.echo(json.dumps(_described(found), indent=1, allow_nan=False) if as_json else _text(found))
    return 0 if found.healthy else CheckError.exit_code


def _text(found: "Examination") -> str:
    lines = [f"{printable(str(found.path))}: {found.format}", f"configuration: {found.configuration or 'none'}", ""]
    lines += [f"{d.level:8}{d.code}: {d.text}" for d in found.findings]
    counts = {level: sum(d.level == level for d in found.findings) for level in ("error", "warning", "info")}
    named = zip(counts.values(), *NAMES, strict=True)
    total = ", ".join(f"{n} {name if n == 1 else names}" for n, name, names in named)
    return "\n".join([*lines, *([""] if found.findings else []), total])


NAMES = (("error", "warning", "remark"), ("errors", "warnings", "remarks"))


def _described(found: "Examination") -> dict[str, Any]:
    from dataclasses import asdict

    from usbldr.io.reports.run_provenance import made_by

    return {
        **made_by(),
        "path": str(found.path),
        "format": found.format,
        "configuration": str(found.configuration) if found.configuration else None,
        "start_ns": found.log.start_ns if found.log else None,
        "healthy": found.healthy,
        "findings": [{k: v for k, v in asdict(f).items() if k != "lost_data"} for f in found.findings],
    }

"""One method on one log, judged: what replay does once and compare many times."""

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import click

from usbldr.filters.errors import LogError
from usbldr_cli.options.run_options import RunChoices

if TYPE_CHECKING:
    from usbldr.filters.replay.dead_reckoning import Anchor
    from usbldr.filters.types import Timeline
    from usbldr.io.log import Log
    from usbldr.io.reports.report_json import ScoredTrack


def score(
    method: str, log: "Log", dive_timeline: "Timeline", choices: RunChoices, anchor: "Anchor | None", shown: bool = True
) -> "ScoredTrack":
    """Make a track and take its errors: raw fixes at their own stamps, all others on the slow grid.

    ``shown``: with a progress bar while stderr is a terminal.
    """
    from usbldr.filters.evaluation.evaluation import evaluate
    from usbldr.filters.replay.methods import method_named
    from usbldr.filters.replay.position_fixes import require_gps
    from usbldr.filters.replay.prior import NO_START_TEXT, starting_fixes
    from usbldr.filters.replay.run import run
    from usbldr.io.reports.report_json import ScoredTrack

    able = method_named(method)
    aid = log.assumptions.aid
    require_gps(dive_timeline, aid, str(log.path))
    if able.is_filter and log.assumptions.start is None and not len(starting_fixes(dive_timeline, log.assumptions)[0]):
        raise LogError(f"{log.path}: {NO_START_TEXT}")
    with _bar(method, len(dive_timeline.time_s), shown) as progress:
        trajectory = run(method, dive_timeline, log.assumptions, choices.settings, progress, anchor)
    if log.truth is None:
        return ScoredTrack(trajectory, None)
    at = None if able.scored_at_fixes else dive_timeline.time_s[dive_timeline.slow]
    return ScoredTrack(trajectory, evaluate(trajectory, log.truth, choices.window(log), choices.align, at, aid))


@contextmanager
def _bar(label: str, total: int, shown: bool) -> Generator[Callable[[int, int], None]]:
    """Show progress on stderr while it is a terminal."""
    hidden = not (shown and sys.stderr.isatty())
    with click.progressbar(length=total, label=label, file=sys.stderr, hidden=hidden) as bar:
        yield lambda done, _: bar.update(done - bar.pos)

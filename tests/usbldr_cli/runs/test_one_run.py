"""One run from a log to its report."""

import weakref

from checkout import SAMPLES
from usbldr.io.reading.opening import DEFAULT_REQUEST
from usbldr.io.session import open_log
from usbldr_cli.options.run_options import RunChoices
from usbldr_cli.runs.one_run import RunPlan, on_epochs, prepare_run


def test_headings_end_when_the_run_is_prepared() -> None:
    choices = RunChoices(2, None, 0, None, None, "none", "start", 5.0, 1.0)
    path = SAMPLES / "paper.mcap"
    log = open_log(path, DEFAULT_REQUEST)
    records = weakref.ref(log.tables["compass"])

    plan = RunPlan(str(path), "adf", choices)

    log, epochs, *_ = prepare_run(plan, log, on_epochs(plan, log)).without_headings()

    assert records() is None
    assert log.tables["compass"].empty
    assert epochs.yaw_count.sum() == log.provenance["compass"].used

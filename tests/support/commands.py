"""Commands of usbldr as tests call them."""

import warnings

from click.testing import CliRunner, Result

from usbldr.filters.errors import UsbldrError
from usbldr_cli.main import cli


def run(*arguments: str) -> Result:
    """Run a command; a warning is a failure, and so is a fault that is no sentence."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        done = CliRunner().invoke(cli, arguments, standalone_mode=False)
    if not isinstance(done.exception, UsbldrError | None) and not type(done.exception).__module__.startswith("click"):
        raise AssertionError(f"usbldr {' '.join(arguments)}: {done.exception!r}") from done.exception
    assert "\n" not in str(done.exception or "")
    return done

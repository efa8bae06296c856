"""The threads of the linear algebra: one, unless the environment says how many."""

import os
import subprocess
import sys

import pytest

from usbldr_cli.options.blas_threads import ONE_THREAD

CODE = """
import os, sys
from usbldr_cli.main import main
assert "numpy" not in sys.modules  # which reads the environment when it is imported
sys.argv[1:] = ["--version"]
try:
    main()
finally:
    print([os.environ.get(name) for name in %r])
"""


@pytest.mark.parametrize(("asked", "threads"), [({}, "1 1 1 1"), ({"OMP_NUM_THREADS": "3"}, "3 None None None")])
def test_the_command_uses_one_thread_unless_told_otherwise(asked: dict[str, str], threads: str) -> None:
    environment = {name: text for name, text in os.environ.items() if name not in ONE_THREAD} | asked
    words = [sys.executable, "-c", CODE % list(ONE_THREAD)]

    printed = subprocess.run(words, env=environment, capture_output=True, text=True, check=True).stdout.splitlines()[-1]

    assert printed == str([None if text == "None" else text for text in threads.split()])

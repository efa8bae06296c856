"""What `usbldr --help` costs beside `python -c 'import click'`: whole processes, in turn, median of pairs.

$ python benchmarks/speed/startup.py
"""

import statistics
import subprocess
import sys
import time


def seconds(command: list[str]) -> float:
    began = time.perf_counter()
    subprocess.run(command, check=True, capture_output=True)
    return time.perf_counter() - began


def main(pairs: int = 15) -> None:
    call = "import sys; sys.argv = ['usbldr', '--help']; from usbldr_cli.main import main; main()"
    helped = [sys.executable, "-c", call]
    click = [sys.executable, "-c", "import click"]
    seconds(helped), seconds(click)  # warm the file cache
    times = [(seconds(helped), seconds(click)) for _ in range(pairs)]
    ratio = statistics.median(a / b for a, b in times)
    own, other = (1000 * statistics.median(column) for column in zip(*times, strict=True))
    print(f"usbldr --help {own:.0f} ms, import click {other:.0f} ms, ratio {ratio:.2f} (at most 1.6 is wanted)")


if __name__ == "__main__":
    main()

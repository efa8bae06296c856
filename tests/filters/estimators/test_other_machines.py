"""The kernel of other compilers and of ARM against the one that is installed, on the calls of some runs.

ARM is emulated (Debian: gcc-aarch64-linux-gnu and qemu-user). Its logarithms and error functions come from another
library of mathematics, which may round the last digit otherwise.
"""

import shutil
import struct
import subprocess
import tomllib
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from checkout import ROOT
from needed_kernel import require_kernel
from usbldr.filters.estimators import compiled
from usbldr.filters.kernel import KERNEL
from usbldr.filters.models.noise import Mixture, StudentT
from usbldr.filters.models.parameters import Parameters
from usbldr.filters.replay.methods import FilterSettings
from usbldr.filters.replay.run import run
from weaving import Faults, weaving_dive

SOURCES = ROOT / "filters" / "kernel"
FLAGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["setuptools"]["ext-modules"][0]
MACHINES = {
    "ARM": (("aarch64-linux-gnu-gcc", "-static"), ("qemu-aarch64",)),
    "clang": (("clang",), ()),
    "one number at a time": (("gcc", "-DONE_AT_A_TIME"), ()),
}


class Recorder:
    """Runs the installed kernel, and keeps what it was given and what it returned."""

    def __init__(self) -> None:
        self.calls, self.answers = bytearray(), bytearray()

    def __call__(self, *given: Any) -> int:
        assert KERNEL.advance is not None
        _, settings, past, count, steps, readings, log_relocation, outlier_m2, *changed = given
        watched = b"" if log_relocation is None else log_relocation
        blocks = [bytes(block) for block in (settings, steps, readings, watched, *changed)]
        self.calls += struct.pack("=9qd", *map(len, blocks), past, count, outlier_m2) + b"".join(blocks)
        done = KERNEL.advance(*given)
        self.answers += struct.pack("=q", done) + b"".join(
            map(bytes, changed[1:])
        )  # the unused places of a bank differ
        return done


@pytest.fixture(scope="module")
def recorded() -> Recorder:
    """Hypotheses, resampling, a gap of the DVL, all kinds of states and sigma points."""
    require_kernel()
    line, found = weaving_dive(Faults(0.01, 2.0, 1.0, 2.0, 1.0, 0.3, 0.1, -0.2), seconds=12), Recorder()
    line = replace(line, dvl_count=np.where((line.time_s > 4) & (line.time_s < 9), 0, line.dvl_count))
    parameters = Parameters(usbl_lever_m=(0.5, -1.0, 0.0), dvl=Mixture(), usbl=StudentT())
    errors = ("scale", "misalignment", "heading", "deviation", "latency", "usbl-bias", "current")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(compiled, "KERNEL", KERNEL._replace(advance=found))
        for name in ("ekf", "adf", "cpf"):
            run(name, line, replace(parameters, calibrate=errors), FilterSettings(particles=11))
        run("upf", line, parameters, FilterSettings(particles=40, guard=False))
    return found


@pytest.mark.parametrize("machine", MACHINES)
def test_another_machine_gives_the_same_numbers(machine: str, recorded: Recorder, tmp_path: Path) -> None:
    (compiler, *options), emulator = MACHINES[machine]
    if missing := [tool for tool in (compiler, *emulator) if shutil.which(tool) is None]:
        pytest.skip(f"{machine}: {' and '.join(missing)} not installed")
    program = str(tmp_path / "driver")
    files = [str(ROOT / "tests" / "support" / "kernel_driver.c"), str(SOURCES / "variant_portable.c")]
    flags = [*FLAGS["extra-compile-args"], "-O1", f"-I{SOURCES}"]  # -O3 takes a minute more and changes no number
    subprocess.run([compiler, *options, *flags, *files, "-o", program, "-lm"], check=True)

    done = subprocess.run([*emulator, program], input=recorded.calls, capture_output=True, check=True)

    got, want = np.frombuffer(done.stdout), np.frombuffer(recorded.answers)
    rounding = 1e-12 if machine == "ARM" else 0.0
    np.testing.assert_allclose(got, want, rtol=rounding, atol=rounding)

"""What is declared once in filters/models holds in files, options, texts and runs."""

import subprocess
import sys
import tomllib
from dataclasses import astuple, replace
from pathlib import Path
from typing import Any

import pytest

from usbldr.filters.models.calibration import REPORTED_QUANTITIES
from usbldr.filters.models.noise import FAMILIES, Gaussian
from usbldr.filters.models.parameters import ProcessNoise, SensorErrors, Start
from usbldr.filters.models.quantities import SENSOR_UNITS, quantities
from usbldr.io.scenarios.shipped import find_scenario
from usbldr.io.scenarios.simulated_log import write_scenario
from usbldr.io.settings.noise_sections import NOISES, noise_family_of, section_of, stated_model
from usbldr.io.settings.sensor_sections import Configuration
from usbldr.io.settings.toml_text import noise_text, stated
from usbldr.io.settings.validation import checked

NEW_FAMILY = '''
from dataclasses import dataclass
from typing import Annotated
import numpy as np
from usbldr.filters.models.noise import FAMILIES, Noise
from usbldr.filters.models.quantities import Limits, Quantity

@dataclass(frozen=True, slots=True)
class Wide:
    """N(0, R) or as often N(0, (factor R) + sd^2 I)."""

    factor: Annotated[float, Quantity("factor", Limits(1.0, 100.0))] = 4.0
    sd: Annotated[float, Quantity("sd_{unit}")] = 1.0
    per_scalar: bool = False

    def modes(self, R):
        wide = self.factor * R + self.sd**2 * np.eye(R.shape[-1])
        return Noise(np.full(2, 0.5), np.array([R, wide]), self.per_scalar)

FAMILIES["wide"] = Wide

import sys
from pathlib import Path
from usbldr.io.reading.read import read_log
from usbldr.io.settings.toml_text import noise_text
from usbldr_cli.main import cli
from usbldr_cli.options.option_texts import noise_family

log, out = sys.argv[1:]
assert noise_family("compass=wide:9:2:scalar")[1].factor == 9.0
text = noise_text(read_log(Path(log)).parameters.usbl, "usbl")
assert text == '{ kind = "wide", factor = 5.0, sd_m = 3.0, per = "record" }'
cli(["replay", log, "-f", "adf", "--calibrate", "none", "--noise", "dvl=wide:2:0.01", "-o", out, "-q"])
'''


@pytest.mark.long
def test_a_noise_family_is_added_in_one_place(tmp_path: Path) -> None:
    log, script, own = tmp_path / "dive.mcap", tmp_path / "script.py", tmp_path / "dive.usbldr.toml"
    scenario = replace(find_scenario("lawnmower"), duration_s=60.0)
    write_scenario(scenario, 0, log)
    assumed = scenario.usbl.assumed_noise or scenario.usbl.noise
    text, usual = own.read_text(encoding="utf-8"), noise_text(assumed, "usbl")
    before, section, after = text.partition("[usbl]")
    wide = '{ kind = "wide", factor = 5.0, sd_m = 3.0 }'
    assert usual in after
    own.write_text(before + section + after.replace(usual, wide, 1), encoding="utf-8")
    script.write_text(NEW_FAMILY, encoding="utf-8")

    done = subprocess.run([sys.executable, script, log, tmp_path / "run"], capture_output=True, text=True, check=False)

    assert (done.returncode, done.stderr) == (0, "")
    assert (tmp_path / "run" / "report.json").is_file()


@pytest.mark.parametrize("sensor", SENSOR_UNITS)
@pytest.mark.parametrize("kind", FAMILIES)
def test_the_text_of_a_noise_is_read_as_that_noise(kind: str, sensor: str) -> None:
    for per_scalar in (True, False):
        family = FAMILIES[kind](per_scalar=per_scalar)
        if sensor != "usbl" and kind == "contamination":
            family = replace(family, sd=0.25)

        read = tomllib.loads(f"noise = {noise_text(family, sensor)}")["noise"]

        assert noise_family_of(checked(read, NOISES[sensor], "file"), Gaussian(), sensor) == family


@pytest.mark.parametrize("value", [ProcessNoise(), SensorErrors(), Start(1.0, 2.0, 3.0)])
def test_the_text_of_a_model_is_read_as_that_model(value: Any) -> None:
    read = {key: float(text) for key, text in stated(value).items()}

    again = stated_model(value, checked(read, section_of(type(value)), "file"))

    assert astuple(again) == pytest.approx(astuple(value), rel=1e-14)  # not each radian is a double in degrees
    assert len(read) == len(quantities(type(value))) == len(type(value).__dataclass_fields__)


def test_an_error_that_can_be_subtracted_names_a_key_of_its_sensor() -> None:
    usual = Configuration()
    keys = [(one.section, one.key) for one in REPORTED_QUANTITIES.values() if one.key]

    assert len(set(keys)) == len(keys) == 6
    assert [getattr(getattr(usual, section), key) for section, key in keys] == [0.0] * 6

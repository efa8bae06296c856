"""The option --noise: what it means, and what it refuses."""

import math

import pytest

from usbldr.filters.errors import UsageError
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, StudentT
from usbldr_cli.options.noise_option import noise_family


@pytest.mark.parametrize(
    ("text", "means"),
    [
        ("usbl=gaussian", ("usbl", Gaussian())),
        ("dvl=mixture", ("dvl", Mixture())),
        ("dvl=mixture:0.2:16:record", ("dvl", Mixture(0.2, 16.0, per_scalar=False))),
        ("usbl=student-t:6", ("usbl", StudentT(6.0))),
        ("usbl=student-t:scalar", ("usbl", StudentT(per_scalar=True))),
        ("usbl=contamination:0.1:25", ("usbl", Contamination(0.1, 25.0))),
        ("compass=contamination:0.1:20", ("compass", Contamination(0.1, math.radians(20.0)))),
    ],
)
def test_a_kind_with_its_numbers_is_a_family(text: str, means: tuple) -> None:
    assert noise_family(text) == means


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("depth=gaussian", "write SENSOR=KIND with a sensor of dvl, compass, usbl, gps"),
        ("usbl", "write SENSOR=KIND"),
        ("usbl=gaussian:1", "gaussian takes no number"),
        ("usbl=mixture:1.2", "share: expected number <= 0.999999999"),
        ("usbl=mixture:0.1:1", "variance_ratio: expected number > 1.0"),
        ("usbl=student-t:1.9", "dof: expected number >= 2.0"),
        ("usbl=student-t:nan", "dof = nan is not a finite number"),
        ("usbl=mixture:x", "'x' is not a number for share"),
        ("dvl=contamination:0.1", "the key sd_mps is missing"),
        ("usbl=contamination:0.1:1:2", "contamination takes share, sd_m, then optionally scalar or record"),
    ],
)
def test_what_is_no_noise_is_a_sentence(text: str, said: str) -> None:
    with pytest.raises(UsageError, match=said.replace("(", r"\(")):
        noise_family(text)

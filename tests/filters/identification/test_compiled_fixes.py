"""The pass over the fixes in the kernel against NumPy, with clusters of false fixes and members of their own noise."""

from dataclasses import replace

import numpy as np
import pytest

from needed_kernel import require_kernel
from usbldr.filters.identification import compiled_fixes
from usbldr.filters.identification.linearisation import DVL_CLOCK, LEVER, NO_ERROR, near
from usbldr.filters.identification.usbl_likelihood import Member, fix_likelihoods
from usbldr.filters.kernel import Kernel
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, NoiseFamily, StudentT
from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorErrors
from usbldr.filters.types import Outage
from weaving import Faults, weaving_dive

require_kernel()

LINE = weaving_dive(Faults(0.01, 0.0, 1.0, 2.0, 1.0, 0.4), seconds=150)
SUBSETS = [*map(frozenset[str], ((), ("scale",), ("heading", "deviation"), (LEVER, DVL_CLOCK, "latency")))]
FAMILIES = [Gaussian(), Gaussian(per_scalar=False), Mixture(), Contamination(), StudentT()]


def member(i: int, family: NoiseFamily) -> Member:
    process = ProcessNoise(position_m=0.02 * (1 + i))
    errors = SensorErrors(usbl_bias_m=0.1 * (1 + i), usbl_bias_s=60.0 + i)
    parameters = Parameters(process=process, errors=errors, usbl=family, usbl_sd_scale=1.0 + 0.1 * i)
    about = near({"usbl_latency": 0.2, "dvl_clock": 0.1}) if i % 4 == 3 else NO_ERROR
    return Member(parameters, SUBSETS[i % 4], about)


@pytest.mark.parametrize("family", FAMILIES, ids=repr)
@pytest.mark.parametrize("correlated", [False, True])
def test_every_member_has_the_same_likelihood_and_errors(monkeypatch, family: NoiseFamily, correlated: bool) -> None:
    fix_m, cov_m2 = LINE.fix_m.copy(), LINE.fix_cov_m2.copy()
    fix_m[slice(135, None) if correlated else slice(60, 75)] += (25.0, -10.0)  # the log may end in a cluster
    cov_m2[:, [0, 1], [1, 0]] = 0.01 * correlated
    line = replace(LINE, fix_m=fix_m, fix_cov_m2=cov_m2, outages=(Outage("dvl", 20.0, 30.0),))
    members = [member(i, family) for i in range(11)]

    got = fix_likelihoods(line, members)
    monkeypatch.setattr(compiled_fixes, "KERNEL", Kernel("numpy", "as the test says"))
    want = fix_likelihoods(line, members)

    np.testing.assert_allclose(got.log_likelihood, want.log_likelihood, rtol=1e-9)
    for name in want.mean:
        np.testing.assert_allclose(got.mean[name], want.mean[name], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(got.sd[name], want.sd[name], rtol=1e-7, atol=1e-9)

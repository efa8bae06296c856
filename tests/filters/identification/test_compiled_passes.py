"""The passes over the fixes in the kernel against NumPy: with clusters, with noise of their own, for false fixes."""

from dataclasses import replace

import numpy as np
import pytest

from needed_kernel import require_kernel
from usbldr.filters.identification import false_runs, histories, usbl_likelihood
from usbldr.filters.identification.histories import Followed, HistorySearch
from usbldr.filters.identification.linearisation import DVL_CLOCK, LEVER, NO_ERROR, near
from usbldr.filters.identification.usbl_likelihood import Member, fix_likelihoods
from usbldr.filters.kernel import KERNEL, Kernel
from usbldr.filters.models.noise import Contamination, Gaussian, Mixture, NoiseFamily, StudentT
from usbldr.filters.models.parameters import Parameters, ProcessNoise, SensorErrors, Start
from usbldr.filters.types import Outage, Timeline
from weaving import Faults, weaving_dive

require_kernel()

LINE = weaving_dive(Faults(0.01, 0.0, 1.0, 2.0, 1.0, 0.4), seconds=200)
NUMPY = Kernel("numpy", "as the test says")
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
    fix_m[slice(185, None) if correlated else slice(60, 75)] += (25.0, -10.0)  # the log may end in a cluster
    cov_m2[:, [0, 1], [1, 0]] = 0.01 * correlated
    line = replace(LINE, fix_m=fix_m, fix_cov_m2=cov_m2, outages=(Outage("dvl", 20.0, 30.0),))
    members = [member(i, family) for i in range(11)]

    got = fix_likelihoods(line, members)
    monkeypatch.setattr(usbl_likelihood, "KERNEL", NUMPY)
    want = fix_likelihoods(line, members)

    np.testing.assert_allclose(got.log_likelihood, want.log_likelihood, rtol=1e-9)
    for name in want.mean:
        np.testing.assert_allclose(got.mean[name], want.mean[name], rtol=1e-8, atol=1e-9)
        np.testing.assert_allclose(got.sd[name], want.sd[name], rtol=1e-7, atol=1e-9)


T = LINE.fix_time_s
LEFT = np.clip(T - 150, 0.0, 25.0)[:, None] * (0.1, 0.05)  # slowly from the track, and never back
FAULTS = {
    "none": np.zeros((len(T), 2)),
    "first": (T < 30)[:, None] * (30.0, -20.0),
    "several": (T // 20 % 4 == 1)[:, None] * (12.0, 5.0),
    "gradual": LEFT + ((T > 60) & (T < 66))[:, None] * (60.0, 0.0),
}


def assert_equal(got: list[Followed], want: list[Followed]) -> None:
    assert len(got) == len(want)
    for one, other in zip(got, want, strict=True):
        np.testing.assert_allclose(one.log_weight, other.log_weight, rtol=1e-9, atol=1e-7)
        for name in ("first", "parent", "decision", "gradual"):
            np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("family", [Gaussian(), Contamination(), StudentT()], ids=repr)
def test_histories_are_those_of_numpy(monkeypatch: pytest.MonkeyPatch, family: NoiseFamily, fault: str) -> None:
    def both(search: HistorySearch) -> list[Followed]:
        got = histories.followed(search)
        assert_equal(got, search.followed())
        return got

    monkeypatch.setattr(false_runs, "followed", both)
    cov_m2 = LINE.fix_cov_m2.copy()
    cov_m2[:, [0, 1], [1, 0]] = 0.01
    line: Timeline = replace(LINE, fix_m=LINE.fix_m + FAULTS[fault], fix_cov_m2=cov_m2)
    near_first = Start(*LINE.fix_m[0].tolist(), sd_m=2.0)
    for start, gradual, kinds in ((None, True, range(4)), (near_first, False, range(4)), (None, True, [0, 2])):
        member = Member(Parameters(usbl=family, start=start), frozenset({"scale", "heading", "latency"}))
        found = false_runs.false_runs(line, member, gradual, kinds)
        assert found.kind in kinds
        assert found.false.any() or fault in ("none", "gradual")


def test_numpy_follows_what_the_kernel_has_no_room_for(monkeypatch: pytest.MonkeyPatch) -> None:
    searches: list[HistorySearch] = []
    followed = histories.followed
    monkeypatch.setattr(false_runs, "followed", lambda search: (searches.append(search), followed(search))[1])
    false_runs.false_runs(LINE, Member(Parameters(), frozenset()))
    (search,) = searches
    want = search.followed()

    def refused(*_: object) -> None:
        pytest.fail("the kernel has no room for it")

    for limit in ("states", "modes", "histories"):
        small = KERNEL._replace(limits=KERNEL.limits._replace(**{limit: 1}), run_histories=refused)
        monkeypatch.setattr(histories, "KERNEL", small)
        assert_equal(followed(search), want)
    monkeypatch.setattr(histories, "KERNEL", NUMPY)
    assert_equal(followed(search), want)


def test_arrays_that_do_not_fit_together_are_refused() -> None:
    assert KERNEL.run_histories is not None
    settings = histories.SEARCH.pack(*[1.0] * 5, 10, 3, 1, 1, 2, 10, 10, 1)
    arrays = [np.zeros(size) for size in (6, 60, 9, 1, 12, 10, 100, 3, *[3 * KERNEL.limits.histories] * 5, 3)]
    KERNEL.run_histories(KERNEL.variant, settings, *arrays)
    for short in range(len(arrays)):
        cut = [array[: array.size - (i == short)] for i, array in enumerate(arrays)]
        with pytest.raises(ValueError, match="do not fit together"):
            KERNEL.run_histories(KERNEL.variant, settings, *cut)

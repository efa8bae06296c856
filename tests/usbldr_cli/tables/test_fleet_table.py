"""The row of each dive: which one is named as worse, and what is refused."""

import json

import pytest

from commands import run


def noise(white, slow=0.1):
    return {"white": {"sd": white, "sd_of_sd": 0.02}, "slow": {"sd": slow, "sd_of_sd": 0.05}, "time_constant_s": 60.0}


def a_run(folder, day, white, statistics=True):
    folder.mkdir()
    found = {"fixes": 300, "good_share": 0.95, "range_m": noise(white), "bearing_deg": noise(0.5)}
    found |= {"east_m": None, "north_m": None, "scatter": {"drms_m": 1.0, "cep95_m": 1.7, "drms_percent": None}}
    report = {"log": {"name": "dive.mcap"}, "time_base": {"start_utc": f"2025-06-{day:02}T10:00:00Z"}, "metrics": None}
    (folder / "report.json").write_text(json.dumps(report | {"fix_statistics": found if statistics else None}))
    return str(folder)


def compared(*args):
    return run("compare", *args, "--fixes")


def test_the_dive_that_got_worse_is_named_and_rows_are_in_order_of_time(tmp_path):
    runs = [a_run(tmp_path / f"dive-{day}", day, 0.9 if day == 4 else 0.4 + 0.01 * day) for day in (5, 4, 3, 2, 1)]
    done = compared(*runs)
    assert [line.split()[0] for line in done.output.splitlines()[1:6]] == [f"dive-{day}" for day in range(1, 6)]
    assert done.output.splitlines()[-1] == "dive-4: white noise in range 0.90 m, median of all 0.43 m"
    assert "0.90 ± 0.02*" in done.output


def test_two_dives_name_none(tmp_path):
    done = compared(a_run(tmp_path / "a", 1, 0.4), a_run(tmp_path / "b", 2, 0.9))
    assert "no dive has notably more noise" in done.output


@pytest.mark.parametrize(("statistics", "sentence"), [(False, "no statistics of fixes"), (None, "compares run")])
def test_what_has_no_statistics_is_refused(tmp_path, statistics, sentence):
    other = "paper" if statistics is None else a_run(tmp_path / "b", 2, 0.4, statistics)
    assert sentence in str(compared(a_run(tmp_path / "a", 1, 0.4), other).exception)

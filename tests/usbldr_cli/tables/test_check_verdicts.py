from usbldr.io.settings.regression_baseline import BaselineRow, Metric
from usbldr_cli.tables.check_verdicts import CheckedRow, compare_metric, table


def test_the_change_is_the_difference_of_the_values_as_printed() -> None:
    change = compare_metric("mean_horizontal_m", Metric(value=1.31286, abs=0.005), 1.31284)
    row = BaselineRow(name="dive", log="dive.mcap", filter="ekf", seeds=1, options={}, metrics={})

    old, new, moved = table([CheckedRow(row, (change,))]).rows[1][1:4]

    assert float(moved) == round(float(new) - float(old), 6)

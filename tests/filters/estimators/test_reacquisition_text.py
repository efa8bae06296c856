from usbldr.filters.estimators.reacquisition_text import reacquisition_texts
from usbldr.filters.types import Reacquisition


def accepted(since_s: float, jump_m: float, refused: int = 1) -> Reacquisition:
    return Reacquisition(since_s, 1.0, since_s + 5.0, refused, jump_m, accepted=True)


def test_a_few_ambiguities_are_told_one_by_one() -> None:
    rejected = Reacquisition(700.0, 30.0, 704.0, 2, 0.0, accepted=False)

    assert reacquisition_texts([accepted(555.0, 1.7), rejected]) == (
        "USBL fixes from 555.0 s contradicted the track: accepted at 560.0 s after 1 rejected fix; track moved 1.7 m",
        "USBL fixes from 700.0 s (after an outage of 30 s) contradicted the fixes before and after them: "
        "rejected at 704.0 s (2 fixes)",
    )


def test_of_many_ambiguities_the_largest_are_told_in_the_order_of_the_dive() -> None:
    found = [accepted(100.0 * k, jump_m) for k, jump_m in enumerate((1.0, 9.0, 2.0, 8.0, 7.0, 6.0, 5.0))]

    summary, *texts = reacquisition_texts(found)

    assert "7 times: 7 times accepted, 0 times rejected" in summary
    assert [text.rpartition("moved ")[2] for text in texts] == ["9.0 m", "8.0 m", "7.0 m", "6.0 m", "5.0 m"]

"""The files of sentences: what they name is there."""

import pytest
from pynmeagps.nmeatypes_get import NMEA_PAYLOADS_GET

from usbldr.io.decoding.nmea_kinds import CALCULATED, SENTENCE_KINDS
from usbldr.io.messages.registry import LAYOUTS

OF_NO_FIX = ("-1 if invalid", "-1 if quality is 0")


@pytest.mark.parametrize("name", SENTENCE_KINDS)
def test_columns_are_made_of_fields_that_the_sentence_has(name: str) -> None:
    kind = SENTENCE_KINDS[name]
    fields = {field.partition(":")[0] for field in kind.fields.split()} or set(NMEA_PAYLOADS_GET.get(name, ()))
    sources = [source for source in kind.columns.values() if source not in (*CALCULATED, *OF_NO_FIX)]

    assert {word for source in sources for word in source.split() if word != "[rad]"} <= fields
    assert {*kind.invalid} <= fields
    assert bool(kind.invalid) == ("-1 if invalid" in kind.columns.values())
    assert "-1 if quality is 0" not in kind.columns.values() or "quality" in kind.columns


def test_every_kind_that_measures_or_is_refused_is_a_type_of_some_sensor() -> None:
    types = {layout.type for layouts in LAYOUTS.values() for layout in layouts}

    assert {name.lower() for name, kind in SENTENCE_KINDS.items() if kind.columns or name.startswith("P")} <= types

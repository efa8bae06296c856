"""YAML of other programs: numbers, texts, lists and tables, without aliases."""

from collections.abc import Iterable
from typing import Any, cast

YAML_DEPTH = 50  # [levels] of lists and tables; recorders and auv_nav write five


def plain_yaml(text: str | bytes) -> Any:
    """Return the content of a YAML file; raise ValueError if it is none, or has aliases or endless depth."""
    from ruamel.yaml import YAML
    from ruamel.yaml.error import YAMLError

    yaml = cast("Any", YAML(typ="safe"))
    try:
        if _is_plain(yaml.parse(text)):
            return yaml.load(text)
    except (YAMLError, TypeError, RecursionError) as err:
        raise ValueError(" ".join(str(err).split())) from err
    raise ValueError("it has aliases, or is nested too deeply")


def _is_plain(events: Iterable[Any]) -> bool:
    """Return whether the events of a YAML parser have no aliases, which could multiply, and no endless depth."""
    from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent

    depth = 0
    for event in events:
        depth += isinstance(event, CollectionStartEvent) - isinstance(event, CollectionEndEvent)
        if isinstance(event, AliasEvent) or depth > YAML_DEPTH:
            return False
    return True

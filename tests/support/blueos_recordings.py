"""MAVLink messages as the recorder of BlueOS writes them: JSON with the schema of the first message of a topic."""

import json
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from mcap.writer import Writer

Row = tuple[int, str, Mapping[str, Any]]  # log time, message, its fields


def schema_of(value: Any) -> dict[str, Any]:
    """Return a schema as the recorder makes it."""
    if isinstance(value, dict):
        return {"type": "object", "properties": {name: schema_of(inner) for name, inner in value.items()}}
    if isinstance(value, list):
        return {"type": "array", "items": schema_of(value[0]) if value else {}}
    kinds = {str: "string", bool: "boolean", int: "integer", float: "number"}
    return {"type": kinds.get(type(value), "null")}


def write_blueos(file: Path, rows: Iterable[Row], name_of_schema: str = "") -> Path:
    with file.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        channels: dict[str, int] = {}
        for time_ns, kind, fields in rows:
            system = "255/0" if kind.startswith("VISION") else "1/1"
            topic = f"mavlink/{system}/{kind}"
            header = {"system_id": 1, "component_id": 1, "sequence": 7, "message_id": 1}
            value = {"header": header, "message": {"type": kind, **fields}}
            if topic not in channels:
                name = name_of_schema or topic.replace("/", ".")
                schema = writer.register_schema(name, "jsonschema", json.dumps(schema_of(value)).encode())
                channels[topic] = writer.register_channel(topic, "json", schema)
            writer.add_message(channels[topic], time_ns, json.dumps(value).encode(), time_ns)
        writer.finish()
    return file


def delta(time_ns: int, forward_mps: float, starboard_mps: float, confidence: float = 90.0) -> Row:
    moved = [forward_mps * 0.2, starboard_mps * 0.2, 0.01]
    fields = {"time_usec": 0, "time_delta_usec": 200_000, "angle_delta": [0.0] * 3, "position_delta": moved}
    return time_ns, "VISION_POSITION_DELTA", {**fields, "confidence": confidence}

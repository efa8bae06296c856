"""Values by chance for the fields of messages."""

import random
from typing import Any

import numpy as np
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore


def anything(store: Typestore, description: tuple[Any, Any], rng: random.Random, most: int) -> Any:
    """Make a value of a field by chance; lists and texts have up to ``most`` parts."""
    node, what = description
    if node is Nodetype.NAME:
        fields = store.fielddefs[str(what)][1]
        return store.types[str(what)](*(anything(store, kind, rng, most) for _, kind in fields))
    if node is Nodetype.BASE:
        if what[0] == "string":
            return "".join(rng.choice("abcé") for _ in range(rng.randint(0, most)))
        if what[0] == "bool":
            return rng.random() < 0.5
        if what[0].startswith("float"):
            return float(np.float32(rng.gauss(0, 1e3)))
        return rng.randint(0, 100)
    element, count = what
    count = count if node is Nodetype.ARRAY else rng.randint(0, most)
    values = [anything(store, element, rng, most) for _ in range(count)]
    base = str(element[1][0])
    if element[0] is Nodetype.NAME or base == "string":
        return values
    return np.array(values, dtype={"byte": "uint8", "char": "uint8"}.get(base, base))

"""Pages of the studies: which rows they look at, and the shape of their tables."""

from typing import Any


class AskedRows(dict[Any, Any]):
    """Rows that remember which of them were looked at."""

    def __init__(self, rows: Any) -> None:
        super().__init__(rows)
        self.looked_at: set[Any] = set()

    def __getitem__(self, key: Any) -> Any:
        self.looked_at.add(key)
        return super().__getitem__(key)

    def get(self, key: Any, default: Any = None) -> Any:
        self.looked_at.add(key)
        return super().get(key, default)


def table_widths(text: str) -> list[set[int]]:
    """Return of each Markdown table how many cells its lines have."""
    tables = [block.splitlines() for block in text.split("\n\n") if block.startswith("|")]
    return [{line.replace(r"\|", "").count("|") for line in lines} for lines in tables]

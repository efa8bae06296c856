"""What replaces files and folders."""

from pathlib import Path

import pytest

from usbldr.io.writing import replacing


@pytest.mark.parametrize("name", ["old", "run"])
def test_a_folder_of_any_name_is_replaced_as_a_whole_or_not_at_all(tmp_path: Path, name: str) -> None:
    target = tmp_path / name
    for content in ("first", "second"):
        with replacing(target, "") as new:
            new.mkdir()
            (new / content).touch()

    def interrupted() -> None:
        with replacing(target, "") as new:
            new.mkdir()
            (new / "half").touch()
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()

    assert [file.name for file in target.iterdir()] == ["second"]
    assert list(tmp_path.iterdir()) == [target]

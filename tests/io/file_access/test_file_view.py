"""The bytes of a file, looked at in pieces: the same as those of the whole."""

import tempfile
from pathlib import Path

from hypothesis import given, settings
from hypothesis import strategies as st

from usbldr.io.file_access.file_view import BLOCK_BYTES, FileView


@settings(max_examples=25)
@given(zeros=st.sampled_from([0, 3, BLOCK_BYTES - 2, BLOCK_BYTES, 3 * BLOCK_BYTES]), data=st.data())
def test_a_file_looked_at_in_pieces_is_the_whole_file(zeros: int, data: st.DataObject) -> None:
    head, tail = data.draw(st.binary(max_size=9)), data.draw(st.binary(max_size=9))
    whole = head + bytes(zeros) + b"\x89MARK" + tail
    start, stop = sorted(data.draw(st.tuples(*[st.integers(0, len(whole))] * 2)))
    with tempfile.TemporaryDirectory() as name:
        file = Path(name) / "a"
        with file.open("wb") as written:  # zeros as a hole, if the file system has any
            written.write(head)
            written.seek(zeros, 1)
            written.write(whole[len(head) + zeros :])
        with file.open("rb") as content:
            view = FileView(content.fileno())
            assert len(view) == len(whole)
            assert view[start:stop] == whole[start:stop]
            assert view.find(b"\x89MARK", start) == whole.find(b"\x89MARK", start)
            assert view.find(b"\x89MARK", start, stop) == whole.find(b"\x89MARK", start, stop)
            assert view.after_zeros(start) == max(start, len(whole) - len(whole[start:].lstrip(b"\0")))
            assert content.read() == whole

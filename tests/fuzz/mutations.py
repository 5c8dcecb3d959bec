"""Files as users break them: whole ones with lines, words and bytes changed, seeded by Hypothesis."""

from hypothesis import strategies as st

WORDS = (
    b"",
    b"0",
    b"-1",
    b"1e300",
    b"-1e300",
    b"1e-300",
    b"1e-9",
    b"1000000000000000000000000000000",
    b".nan",
    b".inf",
    b"nan",
    b"inf",
    b"0x10",
    b"1:2:3",
    b"true",
    b"null",
    b"~",
    b"[]",
    b"{}",
    b"[1, 2]",
    b"{a: 1}",
    b"''",
    b"text",
    b"\x00",
    b"\xff",
    b"&a",
    b"*a",
    b"!!python/object/apply:os.system [exit]",
    b"!!binary x",
    b"!!int ''",
    b"!!timestamp x",
    b"2001-99-99",
    b"<<: *a",
    b"? [1]",
    b"#",
    b"'",
    b'"',
    b",",
    b"\n",
    b"\r",
    b"\t",
    b"P2",
    b"65536",
    b"a" * 300,
    b"\xe2\x80\xa8",
)
"""What is put in the place of a word, or between two."""

EDITS = ("replace", "insert", "drop", "copy", "cut", "flip")


@st.composite
def broken(draw: st.DrawFn, whole: bytes) -> bytes:
    """`whole` after a few edits, each at a word's border or at any byte."""
    text = whole
    for _ in range(draw(st.integers(1, 4))):
        edit = draw(st.sampled_from(EDITS))
        at = draw(st.integers(0, max(0, len(text) - 1)))
        begin, end = _find_word(text, at)
        word = draw(st.sampled_from(WORDS))
        if edit == "replace":
            text = text[:begin] + word + text[end:]
        elif edit == "insert":
            text = text[:begin] + word + b" " + text[begin:]
        elif edit == "drop":
            text = text[:begin] + text[end:]
        elif edit == "copy":
            other = draw(st.integers(0, max(0, len(text) - 1)))
            text = text[:begin] + text[slice(*_find_line(text, other))] + text[begin:]
        elif edit == "cut":
            text = text[:at]
        elif text:
            text = text[:at] + bytes([text[at] ^ (1 << draw(st.integers(0, 7)))]) + text[at + 1 :]
    return text


def _find_word(text: bytes, at: int) -> tuple[int, int]:
    begin = end = at
    while begin > 0 and text[begin - 1] not in b" ,:[]{}\n":
        begin -= 1
    while end < len(text) and text[end] not in b" ,:[]{}\n":
        end += 1
    return begin, end


def _find_line(text: bytes, at: int) -> tuple[int, int]:
    begin = text.rfind(b"\n", 0, at) + 1
    end = text.find(b"\n", at)
    return begin, len(text) if end < 0 else end + 1

"""Text in the encodings that programs write."""

import codecs

# The content by whose zeros text of two bytes a character is told.
_SAMPLE = 4096
_MARKS = {
    codecs.BOM_UTF8: "utf-8-sig",
    codecs.BOM_UTF32_LE: "utf-32",
    codecs.BOM_UTF32_BE: "utf-32",
    codecs.BOM_UTF16_LE: "utf-16",
    codecs.BOM_UTF16_BE: "utf-16",
}


def text_of(content: bytes) -> str | None:
    """Return the text of a file in UTF-8, UTF-16, UTF-32 or Latin-1, None for binary content.

    Example:
        >>> js.surfaces.text_of("Höhe 1.5 µm".encode("utf-16"))
        'Höhe 1.5 µm'
    """
    # The mark of UTF-32 begins with the one of UTF-16, and comes first.
    encoding = next((name for mark, name in _MARKS.items() if content.startswith(mark)), None)
    if encoding is None:
        encoding = _without_mark(content[:_SAMPLE])
    if encoding is None:
        return None
    try:
        return content.decode(encoding)
    except UnicodeDecodeError:
        if encoding != "utf-8":
            return None
        # Older programs write units and comments in Latin-1.
        return content.decode("latin-1")


def _without_mark(sample: bytes) -> str | None:
    """Return the encoding of a text that begins with no mark, by the places of its zeros."""
    if b"\0" not in sample:
        return "utf-8"
    # Most characters are of ASCII, whose upper byte is zero.
    for lower, encoding in ((0, "utf-16-le"), (1, "utf-16-be")):
        upper = sample[1 - lower :: 2]
        if b"\0" not in sample[lower::2] and 2 * upper.count(0) > len(upper):
            return encoding
    return None

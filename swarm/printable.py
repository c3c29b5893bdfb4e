"""Text from outside as it may be shown: on one line, of bounded length, without anything that steers a terminal."""

MOST = 300  # characters; a key expression of Zenoh may have thousands


def printable(text: str, most: int = MOST) -> str:
    """`text` with line breaks, ESC, direction marks and all else that is not printable as backslash escapes.

    What is longer than `most` characters is cut off and ends in "…". Safe text comes back as it is.
    """
    kept = text[:most]
    if not kept.isprintable():
        kept = "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in kept)
    return kept + "…" * (len(text) > most)


def printable_lines(text: str) -> str:
    """The same for text of several lines, each of them as long as it is."""
    return "\n".join(printable(line, len(line)) for line in text.split("\n"))

"""Text from outside in one line: messages of libraries, and names and values of a file."""

__all__ = ["one_line", "visible"]


def one_line(found: object, *, max_characters: int | None = None) -> str:
    """The text of an error or of any other thing, with one blank in place of line ends and of several blanks."""
    return " ".join(str(found).split())[:max_characters]


def visible(text: str) -> str:
    r"""The text with `\x1b` and the like in place of all that is not printable, line ends and tabs too.

    Not printable are control characters (C0, C1), format characters (direction of writing, no width), separators other
    than the blank, surrogates (bytes of a file name that are no UTF-8), and what Unicode does not assign.
    """
    if text.isprintable():
        return text
    return "".join(letter if letter.isprintable() else repr(letter)[1:-1] for letter in text)

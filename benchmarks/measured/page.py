"""A part of a page of the documents that a program writes."""

from pathlib import Path


def write_part(page: Path, name: str, text: str) -> None:
    """Write the lines between `<!-- NAME: begin -->` and `<!-- NAME: end -->` anew.

    Raises:
        ValueError: the page has no such part.
    """
    begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, also_found, after = rest.partition(end)
    if not (found and also_found):
        raise ValueError(f"{page}: expected {begin} and {end}")
    page.write_text(f"{before}{begin}\n\n{text.strip()}\n\n{end}{after}", encoding="utf-8")

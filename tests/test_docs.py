"""The documents say what the program does, and what they link to exists."""

import re
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from document_commands import ROOT, pages
from typer.main import get_command

from lidcam.commands import process_app

README = (ROOT / "README.md").read_text(encoding="utf-8")
OF_EVERY_COMMAND = {"--help", "--version"}
HOME = re.compile(
    r"https://(?:github\.com/lidcam/lidcam/(?:blob|tree)|raw\.githubusercontent\.com/lidcam/lidcam)/main/(.+)"
)


def test_the_table_of_options_is_complete() -> None:
    options = {
        option for parameter in get_command(process_app).params for option in parameter.opts if option[:2] == "--"
    }
    table = (
        (ROOT / "docs" / "process.md")
        .read_text(encoding="utf-8")
        .split("| option of `lidcam-process` | |")[1]
        .split("\n\n")[0]
    )
    assert set(re.findall(r"--[a-z][a-z0-9-]+", table)) == options - OF_EVERY_COMMAND


@pytest.mark.parametrize("page", pages(), ids=lambda path: path.name)
def test_links_lead_somewhere(page: Path) -> None:
    """In the README links are absolute, since it is also shown by an index of packages."""
    for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8")):
        at_home = HOME.fullmatch(link)
        assert page.name != "README.md" or page.parent != ROOT or link.startswith("https://"), link
        if at_home:
            assert (ROOT / at_home[1]).exists(), link
        elif "://" not in link:
            assert (page.parent / link.split("#")[0]).exists(), link


@pytest.mark.parametrize(
    "path", sorted(set(re.findall(r"(?<!/)\b(?:config|docs|pipeline|bags)/[\w/.]+\.(?:md|py|yaml|bag)\b", README)))
)
def test_named_files_exist(path: str) -> None:
    assert (ROOT / path).is_file()


def test_the_citation_names_this_version() -> None:
    cited = re.search(r"^version: (.*)$", (ROOT / "CITATION.cff").read_text(encoding="utf-8"), re.MULTILINE)
    assert cited
    assert cited[1] == version("lidcam")


@pytest.mark.parametrize("path", sorted(ROOT.glob(".github/**/*.yml")), ids=lambda path: path.name)
def test_workflows_call_targets_that_exist_and_pin_what_they_use(path: Path) -> None:
    text, makefile = path.read_text(encoding="utf-8"), (ROOT / "Makefile").read_text(encoding="utf-8")
    assert yaml.safe_load(text)
    for target in re.findall(r"run: make (\w+)", text):
        assert re.search(rf"^{target}:", makefile, re.MULTILINE)
    assert all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v[\d.]+", use) for use in re.findall(r"uses: (.*)", text))

"""The documents say what the program does, and what they link to exists."""

import os
import re
import subprocess
import sys
from importlib.metadata import version
from pathlib import Path

import pytest
import yaml
from document_commands import pages
from helpers import ROOT
from typer.main import get_command

import lidcam.api
from lidcam.cli import process_app

README = (ROOT / "README.md").read_text(encoding="utf-8")
OF_EVERY_COMMAND = {"--help", "--version"}
HOME = re.compile(
    r"https://(?:github\.com/lidcam/lidcam/(?:blob|tree)|raw\.githubusercontent\.com/lidcam/lidcam)/main/([^#]+)(?:#.*)?"
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


def test_links_lead_somewhere() -> None:
    """In the README links are absolute, since it is also shown by an index of packages."""
    links = [
        (page, link) for page in pages() for link in re.findall(r"\]\(([^)\s]+)\)", page.read_text(encoding="utf-8"))
    ]
    assert not [link for page, link in links if page == ROOT / "README.md" and not link.startswith("https://")]
    at_home = {(page, link): HOME.fullmatch(link) for page, link in links}
    files = {key: ROOT / found[1] for key, found in at_home.items() if found}
    files |= {(page, link): page.parent / link.split("#")[0] for page, link in links if "://" not in link}
    assert len(files) > 50
    assert [key for key, path in files.items() if not path.exists()] == []


@pytest.mark.slow
def test_the_site_is_built_without_warnings(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path / "site")]
    done = subprocess.run(
        command, cwd=ROOT, env={**os.environ, "NO_MKDOCS_2_WARNING": "1"}, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    api = (tmp_path / "site" / "api" / "index.html").read_text(encoding="utf-8")
    assert (tmp_path / "site" / "llms.txt").is_file()
    shown = set(re.findall(r'id="lidcam\.api\.(\w+)"', api))
    assert set(lidcam.api.__all__) - shown == {"__version__"}


def test_language_models_are_told_of_every_page() -> None:
    """https://llmstxt.org: a title, a summary, sections of links."""
    text = (ROOT / "docs" / "llms.txt").read_text(encoding="utf-8")
    assert re.match(r"# lidcam\n\n> .+\n\n", text)
    listed = re.findall(r"^- \[[^\]]+\]\(https://lidcam\.github\.io/lidcam/([\w-]+)/\): .+$", text, re.MULTILINE)
    assert sorted(listed) == sorted(path.stem for path in (ROOT / "docs").glob("*.md") if path.stem != "index")


@pytest.mark.parametrize(
    ("translated", "original"), [("zh/index.md", "../README.md"), ("zh/first-bag.md", "first-bag.md")]
)
def test_translated_pages_have_the_commands_of_the_original(translated: str, original: str) -> None:
    of_page, of_original = (
        {
            re.split(r"\s{3,}", line)[0]
            for block in re.findall(r"```\w*\n(.*?)```", text, re.DOTALL)
            for line in block.splitlines()
        }
        for text in ((ROOT / "docs" / page).read_text(encoding="utf-8") for page in (translated, original))
    )
    assert len(of_page) > 5
    assert of_page - of_original == set()


def test_no_page_escapes_a_bar() -> None:  # the site would show the backslash
    assert [page.name for page in (ROOT / "docs").glob("*.md") if "\\|" in page.read_text(encoding="utf-8")] == []


def test_named_files_exist() -> None:
    named = set(re.findall(r"(?<!/)\b(?:config|docs|pipeline|bags)/[\w/.]+\.(?:md|py|yaml|bag)\b", README))
    assert {path for path in named if not (ROOT / path).is_file()} == set()


def test_the_citation_names_this_version() -> None:
    citation = (ROOT / "CITATION.cff").read_text(encoding="utf-8")
    assert re.findall(r"^version: (.*)$", citation, re.MULTILINE) == [version("lidcam")]


def test_workflows_call_targets_that_exist_and_pin_what_they_use() -> None:
    targets = re.findall(r"^(\w+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    texts = [path.read_text(encoding="utf-8") for path in ROOT.glob(".github/**/*.yml")]
    assert len(texts) > 2
    for text in texts:
        assert yaml.safe_load(text)
        assert {*re.findall(r"run: make (\w+)", text)} <= {*targets}
        assert all(re.fullmatch(r"[\w/-]+@[0-9a-f]{40} # v[\d.]+", use) for use in re.findall(r"uses: (.*)", text))

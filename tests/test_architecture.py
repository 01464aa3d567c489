"""Who may import whom, and what library code may not do: read from the sources, so that no file can hide."""

import ast
from functools import cache
from pathlib import Path

from changed_tests import mirrored_tests
from helpers import ROOT
from import_graph import (
    FLOORS,
    ImportGraph,
    circles,
    lines_by_room,
    module_name,
    our_imports,
    package_of,
    read_import_graph,
    room_of,
    sources,
    tree_of,
)

MAX_FILES = 16

# Within its floor: what a room may import of the others. Rooms that are not named here may import all of their floor
# as long as no circle comes of it.
MAY_IMPORT = {
    "lidcam.pipeline.graph": set(),
    "lidcam.pipeline.parallel": {"lidcam.pipeline.graph", "lidcam.pipeline.core"},
    "lidcam.pipeline.core": {"lidcam.pipeline.native"},
    "lidcam.pipeline.evaluation": {"lidcam.pipeline.core"},
    "lidcam.pipeline.filters": {"lidcam.pipeline.core", "lidcam.pipeline.native"},
    "lidcam.pipeline.detectors": {"lidcam.pipeline.core", "lidcam.pipeline.filters", "lidcam.pipeline.native"},
    "lidcam.pipeline.fusion": {"lidcam.pipeline.core", "lidcam.pipeline.detectors", "lidcam.pipeline.native"},
    "lidcam.pipeline.stages": {
        "lidcam.pipeline.core",
        "lidcam.pipeline.filters",
        "lidcam.pipeline.fusion",
        "lidcam.pipeline.detectors",
        "lidcam.pipeline.native",
    },
}
LOOSE = ("Of ", "Its ", "What ", "That ")
EXITS = {"lidcam.cli.program", "lidcam.signals", "lidcam.pipeline.parallel.pool", "lidcam.pipeline.parallel.worker"}
MAX_LINES = {
    "": (0, 480),
    "bags": (10, 50),
    "bags/simulator": (8420, 2240),
    "benchmarks": (60, 30),
    "benchmarks/measured": (1580, 0),
    "campaign": (0, 560),
    "e2e": (0, 3390),
    "fuzz": (0, 740),
    "lidcam": (1400, 690),
    "lidcam/batches": (1260, 630),
    "lidcam/checks": (1270, 1060),
    "lidcam/cli": (4080, 1660),
    "lidcam/evaluation": (940, 630),
    "lidcam/networks": (180, 170),
    "lidcam/notebook": (880, 270),
    "lidcam/outputs": (2110, 810),
    "lidcam/run": (2960, 1160),
    "lidcam/training": (2540, 880),
    "pipeline": (170, 160),
    "pipeline/calibration": (1010, 510),
    "pipeline/core": (4460, 2330),
    "pipeline/detectors": (3820, 2900),
    "pipeline/evaluation": (3840, 2040),
    "pipeline/filters": (420, 570),
    "pipeline/fusion": (2850, 1680),
    "pipeline/native": (3300, 0),
    "pipeline/parallel": (850, 500),
    "pipeline/stages": (3150, 3360),
    "pipeline/tracking": (2580, 1220),
    "readers": (970, 530),
    "readers/files": (3300, 1870),
    "readers/messages": (3030, 2460),
    "readers/ouster": (420, 270),
    "readers/results": (510, 290),
    "readers/rig": (3580, 2460),
    "readers/streams": (1110, 930),
    "readers/truth": (1350, 1110),
    "readers/velodyne": (850, 470),
    "readers/video": (600, 490),
    "support": (0, 4780),
    "writers": (980, 710),
    "writers/datasets": (900, 400),
    "writers/foxglove": (230, 110),
    "writers/images": (700, 230),
    "writers/live": (130, 0),
    "writers/mcap": (390, 320),
    "writers/messages": (780, 310),
    "writers/outputs": (380, 270),
    "writers/report": (900, 150),
    "writers/rerun": (1120, 470),
    "writers/tables": (430, 210),
}
"""Lines of source, and of tests, that each room may have. One engineer has to hold the house within a week: whoever
needs more changes the number here, in the same commit, and says what the lines are for. The aim is 64,000 and 42,000 in
all.
"""

SOURCES = sources(ROOT)


def name_of(path: Path) -> str:
    return module_name(path, ROOT)


@cache
def graph() -> ImportGraph:
    return read_import_graph(ROOT)


def trees() -> dict[str, ast.Module]:
    return {name_of(path): tree_of(path) for path in SOURCES}


def within(module: str, part: str) -> bool:
    return module == part or module.startswith(f"{part}.")


def test_no_import_points_up() -> None:
    assert not graph().upward


def test_no_circles() -> None:
    assert not circles(graph().modules)
    assert not circles(graph().arrows)


def test_no_folder_is_a_heap() -> None:
    assert {folder: count for folder, count in graph().files.items() if count > MAX_FILES} == {}


def test_no_room_grows_unseen() -> None:
    native = [path for path in (ROOT / "pipeline/native").iterdir() if path.suffix in {".cpp", ".h", ".pyi"}]
    source = lines_by_room([*SOURCES, *native, *(ROOT / "benchmarks").rglob("*.py")], ROOT)
    tests = lines_by_room((ROOT / "tests").rglob("*.py"), ROOT / "tests")
    lines = {room: (source[room], tests[room]) for room in source.keys() | tests.keys()}
    assert lines.keys() == MAX_LINES.keys()
    assert {room: (has, MAX_LINES[room]) for room, has in lines.items() if not _fits(has, MAX_LINES[room])} == {}


def _fits(lines: tuple[int, int], limit: tuple[int, int]) -> bool:
    return lines[0] <= limit[0] and lines[1] <= limit[1]


def test_every_source_is_on_a_floor() -> None:
    folders = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert folders == set(FLOORS)


def test_stages_know_neither_each_other_nor_what_is_above() -> None:
    assert [
        f"{name_of(path)} imports {name}" for path in SOURCES for name in our_imports(path) if _strays(path, name)
    ] == []


def _strays(path: Path, imported: str) -> bool:
    """Whether an import within one floor is none of those in `MAY_IMPORT`."""
    module = name_of(path)
    part = max((part for part in MAY_IMPORT if within(module, part)), key=len, default="")
    same_room = room_of(imported) == room_of(module) != "lidcam.pipeline.stages"
    if not part or package_of(imported) != package_of(module) or same_room:
        return False
    own = ".".join(module.split(".")[:4]) if part == "lidcam.pipeline.stages" else part
    return not any(within(imported, name) for name in (own, *MAY_IMPORT[part]))


def test_library_code_neither_prints_nor_exits() -> None:
    assert {name: found for name, tree in trees().items() if name not in EXITS and (found := _edges(tree))} == {}


def _edges(tree: ast.Module) -> set[str]:
    calls = [node.func for node in ast.walk(tree) if isinstance(node, ast.Call)]
    names = {ast.unparse(one) for one in calls if isinstance(one, ast.Name | ast.Attribute)}
    return names & {"print", "exit", "quit", "sys.exit", "os._exit"}


def test_only_packages_list_their_names() -> None:
    """`__all__` says what is public: the front door and packages have one, modules inside do not."""
    listed = {name for name, tree in trees().items() if any(_assigns(node, "__all__") for node in tree.body)}
    packages = {name_of(path) for path in SOURCES if path.name == "__init__.py"}
    assert listed - packages == {"lidcam.api"}


def _assigns(node: ast.stmt, name: str) -> bool:
    return isinstance(node, ast.Assign) and any(ast.unparse(target) == name for target in node.targets)


def test_docstrings_name_their_subject() -> None:
    """They open with a noun or a verb: "Size of the file", not "Its size" or "What the file holds"."""
    lone = ((name, node) for name, tree in trees().items() for node in ast.walk(tree) if isinstance(node, ast.Expr))
    texts = [(name, ast.unparse(node).strip("'\"")) for name, node in lone if isinstance(node.value, ast.Constant)]
    assert [(name, text) for name, text in texts if text.startswith(LOOSE)] == []


def test_tests_of_a_change() -> None:
    """What `make quick` runs."""
    changed = [
        "pipeline/graph.py",
        "pipeline/stages/no_such.py",
        "docs/a.md",
        "tests/test_docs.py",
        "tests/support/helpers.py",
    ]
    assert mirrored_tests(changed) == [
        "tests/pipeline/stages",
        "tests/pipeline/test_graph.py",
        "tests/test_architecture.py",
        "tests/test_docs.py",
    ]
    assert mirrored_tests(["pipeline/stages/fuse.py", "pipeline/stages/no_such.py"]) == [
        "tests/pipeline/stages",
        "tests/test_architecture.py",
    ]

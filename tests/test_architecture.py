"""Who may import whom, and what library code may not do: read from the sources, so that no file can hide."""

import ast
from pathlib import Path

import pytest
from import_graph import FLOORS, circles, module_name, our_imports, package_of, read_import_graph, room_of, sources

ROOT = Path(__file__).resolve().parent.parent
GRAPH = read_import_graph(ROOT)
MAX_FILES = 16

# Within its floor: what a room may import of the others. Rooms that are not named here may import all of their floor
# as long as no circle comes of it.
MAY_IMPORT = {
    "pipeline.graph": set(),
    "pipeline.parallel": {"pipeline.graph", "pipeline.core"},
    "pipeline.core": set(),
    "pipeline.evaluation": {"pipeline.core"},
    "pipeline.filters": {"pipeline.core"},
    "pipeline.detectors": {"pipeline.core", "pipeline.filters"},
    "pipeline.fusion": {"pipeline.core", "pipeline.detectors"},
    "pipeline.stages": {"pipeline.core", "pipeline.filters", "pipeline.fusion", "pipeline.detectors"},
}
EXITS = {"lidcam.program", "lidcam.start.signals", "pipeline.core.compiled.beside", "pipeline.parallel.worker"}
SOURCES = sources(ROOT)


def name_of(path: Path) -> str:
    return module_name(path, ROOT)


def within(module: str, part: str) -> bool:
    return module == part or module.startswith(f"{part}.")


def test_no_import_points_up() -> None:
    assert not GRAPH.upward


def test_no_circles() -> None:
    assert not circles(GRAPH.modules)
    assert not circles(GRAPH.arrows)


def test_no_folder_is_a_heap() -> None:
    assert {folder: count for folder, count in GRAPH.files.items() if count > MAX_FILES} == {}


def test_every_source_is_on_a_floor() -> None:
    folders = {path.parent.name for path in ROOT.glob("*/__init__.py")}
    assert folders == set(FLOORS)


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_stages_know_neither_each_other_nor_what_is_above(path: Path) -> None:
    module = name_of(path)
    part = max((part for part in MAY_IMPORT if within(module, part)), key=len, default="")
    for imported in our_imports(path):
        if (
            not part
            or package_of(imported) != package_of(module)
            or room_of(imported) == room_of(module) != "pipeline.stages"
        ):
            continue
        own = within(imported, part) and part != "pipeline.stages"
        own_stage = part == "pipeline.stages" and within(imported, ".".join(module.split(".")[:3]))
        assert own or own_stage or any(within(imported, name) for name in MAY_IMPORT[part]), (
            f"{module} imports {imported}"
        )


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_library_code_neither_prints_nor_exits(path: Path) -> None:
    if name_of(path) in EXITS:
        pytest.skip("part of the command line, or of a process that it starts")
    calls = [node.func for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    names = {call.id for call in calls if isinstance(call, ast.Name)}
    attributes = {
        f"{call.value.id}.{call.attr}"
        for call in calls
        if isinstance(call, ast.Attribute) and isinstance(call.value, ast.Name)
    }
    assert not names & {"print", "exit", "quit"}
    assert not attributes & {"sys.exit", "os._exit"}


@pytest.mark.parametrize("path", SOURCES, ids=name_of)
def test_exports_exist(path: Path) -> None:
    tree = ast.parse(path.read_text(encoding="utf-8"))
    exported = [
        element.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id == "__all__"
        for element in getattr(node.value, "elts", ())
        if isinstance(element, ast.Constant)
    ]
    defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    for node in tree.body:
        targets = (
            node.targets if isinstance(node, ast.Assign) else [node.target] if isinstance(node, ast.AnnAssign) else []
        )
        defined |= {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    imported = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))  # also those for type checkers
    defined |= {alias.asname or alias.name for node in imported for alias in node.names}
    assert set(exported) <= defined
    if name_of(path).count(".") and not path.name.startswith("_") and path.name != "__init__.py":
        assert exported, "every module says in __all__ what it offers"

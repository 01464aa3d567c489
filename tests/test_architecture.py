"""Who may import whom, and what library code may not do: read from the sources, so that no file can hide."""

import ast
from functools import cache
from pathlib import Path

from import_graph import (
    FLOORS,
    ImportGraph,
    circles,
    module_name,
    our_imports,
    package_of,
    read_import_graph,
    room_of,
    sources,
)

ROOT = Path(__file__).resolve().parent.parent
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
EXITS = {
    "lidcam.program",
    "lidcam.__main__",
    "pipeline.core.compiled.beside",
    "pipeline.parallel.pool",
    "pipeline.parallel.worker",
}
SOURCES = sources(ROOT)


def name_of(path: Path) -> str:
    return module_name(path, ROOT)


@cache
def graph() -> ImportGraph:
    return read_import_graph(ROOT)


@cache
def trees() -> dict[str, ast.Module]:
    return {name_of(path): ast.parse(path.read_text(encoding="utf-8")) for path in SOURCES}


PACKAGES = {path.relative_to(ROOT).as_posix() for path in SOURCES if path.name == "__init__.py"}


def within(module: str, part: str) -> bool:
    return module == part or module.startswith(f"{part}.")


def test_no_import_points_up() -> None:
    assert not graph().upward


def test_no_circles() -> None:
    assert not circles(graph().modules)
    assert not circles(graph().arrows)


def test_no_folder_is_a_heap() -> None:
    assert {folder: count for folder, count in graph().files.items() if count > MAX_FILES} == {}


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
    same_room = room_of(imported) == room_of(module) != "pipeline.stages"
    if not part or package_of(imported) != package_of(module) or same_room:
        return False
    own = ".".join(module.split(".")[:3]) if part == "pipeline.stages" else part
    return not any(within(imported, name) for name in (own, *MAY_IMPORT[part]))


def test_library_code_neither_prints_nor_exits() -> None:
    assert {name: found for name, tree in trees().items() if name not in EXITS and (found := _edges(tree))} == {}


def _edges(tree: ast.Module) -> set[str]:
    calls = {ast.unparse(node.func) for node in ast.walk(tree) if isinstance(node, ast.Call)}
    return calls & {"print", "exit", "quit", "sys.exit", "os._exit"}


def test_modules_say_what_they_offer_and_offer_it() -> None:
    """Every name in `__all__` is defined or imported at the top of its file."""
    for name, tree in trees().items():
        exported = _exported(tree)
        assert exported <= _defined(tree), name
        is_package = name.replace(".", "/") + "/__init__.py" in PACKAGES
        assert exported or is_package or name.rpartition(".")[2].startswith("_"), f"{name}: expected __all__"


def _exported(tree: ast.Module) -> set[str]:
    return {
        element.value
        for node in tree.body
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__"
        for element in getattr(node.value, "elts", ())
        if isinstance(element, ast.Constant) and isinstance(element.value, str)
    }


def _defined(tree: ast.Module) -> set[str]:
    defined = {node.name for node in tree.body if isinstance(node, ast.FunctionDef | ast.ClassDef)}
    for node in tree.body:
        targets = node.targets if isinstance(node, ast.Assign) else [getattr(node, "target", ast.Pass())]
        defined |= {name.id for target in targets for name in ast.walk(target) if isinstance(name, ast.Name)}
    imports = (node for node in ast.walk(tree) if isinstance(node, ast.ImportFrom))  # also those for type checkers
    return defined | {alias.asname or alias.name for node in imports for alias in node.names}

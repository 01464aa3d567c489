"""Who may import whom, and what library code may not do: read from the sources, so that no file can hide."""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGES = ("pipeline", "readers", "writers", "bags")
CORE = {
    "pipeline.types",
    "pipeline.geometry",
    "pipeline.camera",
    "pipeline.errors",
    "pipeline.config",
    "pipeline.velodyne_models",
}
# From the inside out: each may import those before it.
COMPOSITION = ("pipeline.build", "pipeline.process", "pipeline.report", "pipeline.commands", "pipeline.cli")

# What a module of the first part may import of ours, beside itself and the core.
MAY_IMPORT = {
    "pipeline.stages": {"pipeline.detectors", "pipeline.filters"},
    "pipeline.detectors": {"pipeline.detectors", "pipeline.filters"},
    "pipeline.filters": {"pipeline.filters"},
    "readers": {"readers"},
    "writers": {"writers"},
    "bags": {"bags", "readers.rig_file", "writers.atomic"},  # recordings and rigs are files like any other of ours
    "pipeline.graph": set(),
    "pipeline.errors": set(),
    "pipeline.geometry": set(),
    "pipeline.camera": set(),
    "pipeline.config": set(),
    "pipeline.types": set(),
    "pipeline.velodyne_models": set(),
}
PRINTS = {"pipeline.cli"}

SOURCES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def module_name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def our_imports(path: Path) -> set[str]:
    names: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names.add(node.module or "")
    return {name for name in names if name.split(".")[0] in PACKAGES}


def part_of(module: str) -> str:
    return max((part for part in MAY_IMPORT if module == part or module.startswith(part + ".")), key=len, default="")


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_import_direction(path: Path) -> None:
    module = module_name(path)
    if module in COMPOSITION:
        later = COMPOSITION[COMPOSITION.index(module) + 1 :]
        assert not our_imports(path) & {*later}
        return
    part = part_of(module)
    if module == "pipeline":
        assert not our_imports(path)
        return
    assert part, f"{module} belongs to no known part"
    for imported in our_imports(path) - CORE:
        allowed = any(imported == name or imported.startswith(name + ".") for name in MAY_IMPORT[part])
        own_subpackage = part == "pipeline.stages" and imported.startswith(".".join(module.split(".")[:3]) + ".")
        assert allowed or own_subpackage, f"{module} imports {imported}"


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_library_code_neither_prints_nor_exits(path: Path) -> None:
    if module_name(path) in PRINTS:
        pytest.skip("part of the command line")
    calls = [node.func for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))) if isinstance(node, ast.Call)]
    names = {call.id for call in calls if isinstance(call, ast.Name)}
    attributes = {
        f"{call.value.id}.{call.attr}"
        for call in calls
        if isinstance(call, ast.Attribute) and isinstance(call.value, ast.Name)
    }
    assert not names & {"print", "exit", "quit"}
    assert "sys.exit" not in attributes


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
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
        defined |= {target.id for target in targets if isinstance(target, ast.Name)}
        if isinstance(node, ast.ImportFrom):
            defined |= {alias.asname or alias.name for alias in node.names}
    assert set(exported) <= defined
    if module_name(path).count(".") and not path.name.startswith("_") and path.name != "__init__.py":
        assert exported, "every module says in __all__ what it offers"

"""Who imports whom, by folder, and how many lines there are.

A folder without folders in it is a room, and so is every file that lies beside folders: `readers/open.py` stands above
the containers that it chooses from, `readers/recording.py` below them.
"""

import ast
from collections import Counter, defaultdict
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from helpers import ROOT

FLOORS = {"lidcam": 4, "bags": 3, "readers": 2, "writers": 2, "pipeline": 1}
"""An import points down, or stays in its package; readers and writers do not know each other."""


@dataclass(frozen=True)
class ImportGraph:
    """The imports of a source tree."""

    root: Path
    modules: Mapping[str, frozenset[str]]
    files: Mapping[str, int]

    @property
    def upward(self) -> list[tuple[str, str]]:
        """Imports that point up, or sideways from one package of a floor to the other."""
        return [
            (module, imported)
            for module, names in self.modules.items()
            for imported in sorted(names)
            if package_of(module) != package_of(imported) and FLOORS[package_of(module)] <= FLOORS[package_of(imported)]
        ]

    @property
    def arrows(self) -> dict[str, frozenset[str]]:
        """Rooms that each room imports from, itself aside."""
        rooms: defaultdict[str, set[str]] = defaultdict(set)
        for module, names in self.modules.items():
            room = room_of(module, self.root)
            rooms[room] |= {room_of(name, self.root) for name in names} - {room}
        return {room: frozenset(others) for room, others in sorted(rooms.items())}


def sources(root: Path) -> list[Path]:
    """Every source file of the five packages, in order; the links in `lidcam/` are not followed."""
    return sorted(path for package in FLOORS for path in (root / package).rglob("*.py"))


def module_name(path: Path, root: Path) -> str:
    """The name under which a file is imported."""
    parts = path.relative_to(root).with_suffix("").parts
    inside = parts if parts[0] == "lidcam" else ("lidcam", *parts)
    return ".".join(inside[:-1] if inside[-1] == "__init__" else inside)


@cache
def tree_of(path: Path) -> ast.Module:
    """The syntax tree of a file."""
    return ast.parse(path.read_text(encoding="utf-8"))


@cache
def our_imports(path: Path) -> frozenset[str]:
    """Modules of the five packages that a file names in its import statements."""
    names: set[str] = set()
    for node in _statements(tree_of(path)):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: imports are absolute"
            names.add(node.module or "")
    return frozenset(name for name in names if name.split(".")[0] == "lidcam")


def _statements(tree: ast.AST) -> Iterator[ast.AST]:
    """Every statement, without the expressions in it: there are ten times as many, and none of them imports."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        yield node
        for part in ("body", "handlers", "orelse", "finalbody", "cases"):
            found = getattr(node, part, ())  # of an expression: one more expression
            waiting += found if isinstance(found, list) else ()


def package_of(module: str) -> str:
    """The folder at the top of the repository that a module lies in."""
    parts = module.split(".")
    return parts[1] if len(parts) > 1 and parts[1] in FLOORS else parts[0]


def room_of(module: str, root: Path = ROOT) -> str:
    """The folder of a module; the module itself where folders lie beside it."""
    folder = module.rpartition(".")[0]
    return module if any((root / folder.replace(".", "/")).glob("*/__init__.py")) else folder


def read_import_graph(root: Path) -> ImportGraph:
    """The import graph of the source tree at `root`."""
    paths = [path for path in sources(root) if path.name != "__init__.py" or our_imports(path)]
    return ImportGraph(
        root,
        {module_name(path, root): our_imports(path) for path in paths},
        Counter(str(path.parent.relative_to(root)) for path in sources(root) if path.name != "__init__.py"),
    )


def circles(arrows: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Groups of two and more nodes that reach one another: the strongly connected components."""
    reach = {node: frozenset(_reachable(node, arrows)) for node in arrows}
    groups = {
        tuple(sorted({node} | {other for other in reach[node] if node in reach.get(other, ())})) for node in arrows
    }
    return [list(group) for group in sorted(groups) if len(group) > 1]


def _reachable(start: str, arrows: Mapping[str, Iterable[str]]) -> Iterator[str]:
    seen, waiting = {start}, [start]
    while waiting:
        for name in arrows.get(waiting.pop(), ()):
            if name not in seen:
                seen.add(name)
                waiting.append(name)
                yield name


def lines_by_room(paths: Iterable[Path], base: Path) -> Counter[str]:
    """Lines of files by the first two folders that they lie in below `base`, as `pipeline/core`."""
    lines: Counter[str] = Counter()
    for path in paths:
        room = "/".join(path.relative_to(base).parts[:-1][:2])
        lines[room] += len(path.read_text(encoding="utf-8").splitlines())
    return lines

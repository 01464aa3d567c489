"""Changed scenarios, rigs and settings: `python tests/campaign/scenarios.py [--minutes M | --count N] [--seed S]`.

The bundled YAML files, and rig files of every kind, get wrong types, absurd numbers, unknown keys, tags that name
Python objects, aliases that stand for billions of values, nesting without end, noise and cuts. Each file is loaded and,
where it is accepted, put to use: traffic is laid out, a rig is sought with it, a small drive is processed with the
settings. It may work; else one error in one line must say why, in bounded time and memory.
"""

import logging
import resource
import sys
import tempfile
import warnings
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from random import Random
from typing import Any

from common import ROOT, Outcome, campaign, is_one_line  # isort: skip
import yaml
from builders import write_mcap
from harnesses import CALIB_TXT, CAMCHAIN, GEOMETRY, HOSTILE_YAML, KITTI, RIG, SENSOR_KIT, TO_DO, _use_rig
from small_drive import small_drive

from bags.simulator.scenario.load import load_scenario
from bags.simulator.vehicles.traffic import Traffic
from lidcam import api
from pipeline.core.errors import LidcamError
from pipeline.core.settings.bounded_yaml import parse_yaml
from pipeline.core.settings.config import Config
from pipeline.core.settings.load import dump_config, load_config

__all__ = ["TEST_COUNT", "main"]

TEST_COUNT = 12
MAX_MEMORY = 6 << 30
VALUES: tuple[Any, ...] = (
    None,
    True,
    False,
    0,
    -1,
    1,
    2,
    3.5,
    1e-300,
    1e300,
    float("inf"),
    float("-inf"),
    float("nan"),
    10**400,
    2**63,
    "",
    "x",
    "TODO",
    "/etc/passwd",
    "../..",
    "\x1b[2J\n",
    "é" * 3000,
    [],
    {},
    [None],
    [[[]]],
    {"a": 1},
    {1: 2},
    [0] * 5000,
    list(range(4)),
    [[1, 2], [3]],
)
SNIPPETS = (
    "!!python/object/apply:os.system ['touch hacked']",
    "!!python/name:os.system",
    "!!python/object/new:bags.simulator.scenario.model.Scenario {}",
    "!!binary gIGC",
    "!!set {a, b}",
    "!!timestamp 9999-99-99",
    "!!int '0x" + "f" * 3000 + "'",
    "!!float 1e400",
    "!foo bar",
    "&a [*a]",
    "&a {b: *a}",
    "1:1:1:1:1:1",
    "0o777",
    "9" * 5000,
    ".inf",
    "~",
    "[" * 500,
    "{" * 50 + "}" * 50,
    "? ? ? x",
    "<<: *nothing",
    "'",
    "%YAML 9.9",
)
BASES = {
    "scenario": [ROOT / "config" / "scenarios" / f"{name}.yaml" for name in ("sandbox", "crossing", "vehicle")],
    "rig": [ROOT / "config" / "rigs" / "original.yaml"],
    "settings": [ROOT / "config" / f"{name}.yaml" for name in ("sandbox", "crossing", "road")],
}


def main(arguments: Sequence[str] | None = None) -> int:
    """1 if a file crashed the program, hung it or filled the memory, or was told in more than a line."""
    logging.disable(logging.CRITICAL)
    limits = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (MAX_MEMORY, limits[1]))
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            return campaign("scenarios", _try_case, count=1000, arguments=arguments, max_case_s=30)
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limits)
        logging.disable(logging.NOTSET)


def _try_case(_: int, chance: Random) -> Outcome:
    kind = chance.choice(("scenario", "scenario", "rig", "settings"))
    text = chance.choice(_texts(kind))
    for _ in range(chance.choice((1, 1, 2, 4))):
        text = chance.choice(CHANGES)(text, chance)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.yaml"
        path.write_text(text, errors="surrogatepass")
        try:
            USES[kind](path, chance)
        except LidcamError as err:
            if not is_one_line(str(err)):
                return Outcome("not one line", is_fault=True, detail=str(err), files={"a.yaml": text.encode()})
            return Outcome(f"{kind}: told", detail=str(err))
        except MemoryError:
            return Outcome("memory", is_fault=True, detail=kind, files={"a.yaml": path.read_bytes()})
        except Exception as err:
            import traceback

            return Outcome(
                f"crash: {type(err).__name__}",
                is_fault=True,
                detail=f"{kind}: {traceback.format_exc()}",
                files={"a.yaml": path.read_bytes()},
            )
        finally:
            if Path("hacked").exists():
                raise AssertionError("code of a YAML file was run")
    return Outcome(f"{kind}: works")


@cache
def _texts(kind: str) -> tuple[str, ...]:
    texts = [path.read_text(encoding="utf-8") for path in BASES[kind]]
    if kind == "rig":
        texts += [RIG, GEOMETRY, KITTI, CALIB_TXT, CAMCHAIN, SENSOR_KIT, TO_DO]
    if kind == "settings":
        texts.append(dump_config(Config()))
    return tuple(texts)


# --- uses


def _scenario(path: Path, chance: Random) -> None:
    del chance
    scenario = load_scenario(str(path))
    Traffic(scenario)


def _settings(path: Path, chance: Random) -> None:
    config = load_config(path)
    if chance.random() < 0.5:
        api.process(_drive(), config=config, workers=1)


@cache
def _drive() -> Path:
    path = Path(_folder().name) / "drive.mcap"
    write_mcap(path, small_drive("cdr", frames=3))
    return path


@cache
def _folder() -> tempfile.TemporaryDirectory[str]:
    return tempfile.TemporaryDirectory()


USES: dict[str, Callable[[Path, Random], None]] = {
    "scenario": _scenario,
    "rig": lambda path, _: _use_rig(path),
    "settings": _settings,
}

# --- changes


def _tree_changed(text: str, chance: Random) -> str:
    """A value at any depth is another, gone, doubled, or has an unknown key beside it."""
    try:
        tree = parse_yaml(text)
    except yaml.YAMLError:  # it was changed before
        return text
    places: list[tuple[Any, Any]] = []

    def walk(node: Any) -> None:
        for key in [*node] if isinstance(node, dict) else range(len(node)) if isinstance(node, list) else ():
            places.append((node, key))
            walk(node[key])

    walk(tree)
    if not places:
        return text
    node, key = chance.choice(places)
    match chance.randrange(6):
        case 0:
            del node[key]
        case 1 if isinstance(node, dict):
            node[chance.choice(("x", "", 1, None, "é", f"{key}s"))] = node[key]
        case 2 if isinstance(node[key], int | float):
            node[key] = chance.choice((-node[key], node[key] * 1e6, node[key] * 1e-6, str(node[key]), [node[key]]))
        case 3:
            other, place = chance.choice(places)
            node[key] = other[place] if place in other or isinstance(other, list) else None
        case _:
            node[key] = chance.choice(VALUES)
    try:
        return str(yaml.safe_dump(tree, allow_unicode=True))
    except Exception:  # a value that holds itself and the like
        return text


def _snippet(text: str, chance: Random) -> str:
    lines = text.split("\n")
    row = chance.randrange(len(lines))
    key, colon, _ = lines[row].partition(":")
    lines[row] = f"{key}{colon or ':'} {chance.choice(SNIPPETS)}"
    return "\n".join(lines)


def _noise(text: str, chance: Random) -> str:
    letters = [*text] or [" "]
    for _ in range(chance.randint(1, 8)):
        at = chance.randrange(len(letters))
        letters[at] = chance.choice((chr(chance.randrange(1, 256)), *"{}[]:-&*!|>'\"%@`#,? \n\t\0\ud800"))
    return "".join(letters)


def _cut(text: str, chance: Random) -> str:
    return text[: chance.randrange(len(text) + 1)]


def _hostile(text: str, chance: Random) -> str:
    other = chance.choice(HOSTILE_YAML)
    return chance.choice((other, f"{text}\n{other}", f"{other}\n{text}"))


CHANGES: tuple[Callable[[str, Random], str], ...] = (
    *([_tree_changed] * 6),
    _snippet,
    _snippet,
    _noise,
    _cut,
    _hostile,
)

if __name__ == "__main__":
    sys.exit(main())

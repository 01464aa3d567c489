"""Loading scenarios, bundled ones or YAML files."""

from pathlib import Path
from typing import Any

from lidcam.bags.simulator.scenario.scenario import Scenario, listed
from lidcam.pipeline.core.errors import ConfigError
from lidcam.pipeline.core.settings.bounded_yaml import read_yaml
from lidcam.pipeline.core.settings.bundled import bundled
from lidcam.pipeline.core.settings.load import set_values
from lidcam.pipeline.core.settings.validation import checked, did_you_mean


def scenario_names() -> list[str]:
    """Names of the bundled scenarios."""
    return sorted(path.stem for path in bundled("scenarios").glob("*.yaml"))


def load_scenario(name: str, overrides: tuple[str, ...] = ()) -> Scenario:
    """The scenario of this name or YAML file, with overrides of single values, `a.b=value`.

    In an override `*` matches every name: `cameras.*.rate_hz=5`.

    Raises:
        ConfigError: the name is unknown, the file cannot be read, or a key or value is not valid.
    """
    path = Path(name) if Path(name).suffix in {".yaml", ".yml"} else scenario_file(name)
    return _with(read_yaml(path), overrides, str(path))


def scenario_file(name: str) -> Path:
    """The file of a bundled scenario.

    Raises:
        ConfigError: there is none of this name.
    """
    if name not in scenario_names():
        meant = did_you_mean(name, scenario_names())
        raise ConfigError(f"{name}: expected one of {listed(scenario_names())}, or a .yaml file to simulate{meant}")
    return bundled("scenarios", f"{name}.yaml")


def overridden(scenario: Scenario, overrides: tuple[str, ...]) -> Scenario:
    """A scenario with overrides of single values, as of `load_scenario`.

    Raises:
        ConfigError: a key or value is not valid.
    """
    return _with(scenario.model_dump(mode="json"), overrides, "the scenario") if overrides else scenario


def _with(tree: dict[str, Any], overrides: tuple[str, ...], name: str) -> Scenario:
    set_values(tree, tuple(override for given in overrides for override in _for_each(tree, given)))
    return checked(Scenario, tree, f"{name} with --set" if overrides else name)


def _for_each(tree: dict[str, Any], override: str) -> list[str]:
    """The override with each `*` in its key expanded to every name."""
    key, equals, value = override.partition("=")
    if key.startswith("*"):
        raise ConfigError(f"--set {override}: expected a section before the first *, as in cameras.*.rate_hz")
    keys = [""]
    for part in key.split("."):
        keys = [f"{before}{name}." for before in keys for name in (_names_at(tree, before) if part == "*" else [part])]
    if not keys:
        raise ConfigError(f"--set {override}: expected names for * to match, found none")
    return [found.removesuffix(".") + equals + value for found in keys]


def _names_at(tree: dict[str, Any], path: str) -> list[str]:
    for part in path.split(".")[:-1]:
        nested = tree.get(part)
        tree = nested if isinstance(nested, dict) else {}
    return list(tree)

"""The account of a run: what it used, dropped and warned of, kept in its result for whoever opens that later."""

import json
from dataclasses import asdict
from typing import Any

from lidcam.run.job import Job
from lidcam.run.summary import RunSummary, summary_tree

MAX_LISTED = 20
"""Damaged parts and topics of one list: the result says how many more there are."""


def account_text(report: RunSummary, job: Job) -> str:
    """The report of a run as JSON, without times of the clock and without folders of this machine.

    Keys are those of `summary_tree` and `warnings`, `notes`, `incomplete`, `calibration`.
    """
    tree = summary_tree(report)
    for key in ("timing", "outputs", "road_users"):  # the clock's, this machine's; and what the result itself has
        del tree[key]
    losses = tree.pop("losses")
    tree |= {
        "losses": losses[:MAX_LISTED],
        "losses_more": max(len(losses) - MAX_LISTED, 0),
        "warnings": [asdict(warning) for warning in report.warnings],
        "notes": list(report.notes),
        "incomplete": list(report.incomplete),
        "calibration": [asdict(source) for source in report.sensors.calibration],
    }
    names = {str(path): path.name for path in (*job.inputs, *job.read_files)}
    return json.dumps(_named(tree, names), indent=1, ensure_ascii=False)


def _named(value: Any, names: dict[str, str]) -> Any:
    """A tree with the names of files in the place of their paths."""
    if isinstance(value, str):
        for path in sorted(names, key=len, reverse=True):
            value = value.replace(path, names[path])
        return value
    if isinstance(value, dict):
        return {_named(key, names): _named(one, names) for key, one in value.items()}
    return [_named(one, names) for one in value] if isinstance(value, list) else value

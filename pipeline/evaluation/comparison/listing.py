"""Differences as they are told: the earliest ones, and the largest of each kind."""

from collections.abc import Iterable
from typing import Any

import numpy as np

from pipeline.evaluation.comparison.episodes import Difference, Episode
from pipeline.evaluation.comparison.records import KINDS, Channel, Kind

__all__ = ["Listing"]

_WITHOUT_AMOUNT = {"relabelled", "reidentified"}


class Listing:
    """Keeps the earliest episodes and counts all.

    Of those that begin in the same frame, sources come before cameras, and what comes first in the results.

    Args:
        most: Number of episodes that are kept.
    """

    def __init__(self, most: int) -> None:
        self._most = most
        self._kept: list[tuple[int, int, int, Episode]] = []
        self._worst: dict[Kind, tuple[float, tuple[int, int, int], Episode]] = {}
        self._count = 0

    def take(self, episodes: Iterable[Episode], channel_row: int) -> None:
        """Take in episodes that are over, of one channel."""
        for episode in episodes:
            key = episode.first.pair, channel_row, episode.first.row
            self._count += 1
            self._kept.append((*key, episode))
            for kind, (amount, _) in episode.worst.items():
                if kind not in self._worst or (-amount, key) < (-self._worst[kind][0], self._worst[kind][1]):
                    self._worst[kind] = amount, key, episode
        if len(self._kept) >= 2 * self._most:
            self._shorten()

    def figures(self, start_ns: int) -> dict[str, Any]:
        """The episodes as JSON has them, the earliest first, and the one with the largest amount of each kind."""
        self._shorten()
        worst = {
            kind: _worst(self._worst[kind][2], kind, start_ns)
            for kind in KINDS
            if kind in self._worst and kind not in _WITHOUT_AMOUNT
        }
        return {
            "count": self._count,
            "listed": [_tree(episode, start_ns) for *_, episode in self._kept],
            "largest": worst,
        }

    def _shorten(self) -> None:
        self._kept.sort(key=lambda one: one[:3])
        del self._kept[self._most :]


def _tree(episode: Episode, start_ns: int) -> dict[str, Any]:
    first, last = episode.first, episode.last
    kinds = {
        kind: {"frames": episode.counts[kind], "largest": None if kind in _WITHOUT_AMOUNT else episode.worst[kind][0]}
        for kind in KINDS
        if kind in episode.counts
    }
    return {
        **_channel(episode.channel),
        "class": first.class_name,
        "new_class": episode.worst["relabelled"][1].new_class_name if "relabelled" in episode.worst else None,
        "frames": episode.frames,
        "first_frame": first.frame,
        "last_frame": last.frame,
        "first_s": _seconds(first, start_ns),
        "last_s": _seconds(last, start_ns),
        "first_stamp_ns": first.stamp_ns,
        "place": list(first.place),
        "kinds": kinds,
    }


def _worst(episode: Episode, kind: Kind, start_ns: int) -> dict[str, Any]:
    amount, there = episode.worst[kind]
    return {
        **_channel(episode.channel),
        "class": there.class_name,
        "frame": there.frame,
        "s": _seconds(there, start_ns),
        "stamp_ns": there.stamp_ns,
        "place": list(there.place),
        "amount": amount,
    }


def _channel(channel: Channel) -> dict[str, str]:
    kind, name = channel
    return {"source" if kind == "sources" else "camera": name}


def _seconds(difference: Difference, start_ns: int) -> float:
    return float(np.round((difference.stamp_ns - start_ns) / 1e9, 6))

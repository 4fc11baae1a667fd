"""A session as a log of changes, restored bit by bit.

Sessions are immutable and share unchanged parts, so that the log grows only by what is new: a view
when it is taken, its pose alone when an alignment moves it. A ``mark`` record closes each change;
records after the last mark, where a run was killed, are ignored.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, field, is_dataclass, replace
from functools import cache
from typing import Any, get_args, get_origin, get_type_hints

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.exact_json import Packed, pack, pack_fields, unpack, unpack_fields
from scan3d_twin.run.strict_json import parse_json

Record = tuple[str, int, Packed]
"""Kind, index within its kind, and the packed value."""
SESSION, MARK = "session", "mark"
"""Kinds of records besides the names of the lists."""


@dataclass(frozen=True, slots=True)
class Mark:
    """Time, path and pose of the robot at a consistent point of the log.

    Attributes:
        stamp: Time on the robot's clock [s].
        path: Length of the path up to here [m].
        turn: Sum of the turns up to here [rad].
        T_odom_base: Pose of the robot.
    """

    stamp: float = 0.0
    path: float = 0.0
    turn: float = 0.0
    T_odom_base: Pose2 = field(default_factory=Pose2)


@cache
def list_types() -> dict[str, Any]:
    """Return the list fields of a session with the type of their items."""
    hints = get_type_hints(Session)
    return {
        name: get_args(hint)[0]
        for name, hint in hints.items()
        if get_origin(hint) is tuple and get_args(hint)[1:] == (Ellipsis,)
    }


class SessionLog:
    """Finds the changes between the ``last`` state of a session and the next one."""

    def __init__(self, last: Session | None = None) -> None:
        self._last = last

    def changes(self, session: Session, mark: Mark) -> Iterator[Record]:
        """Yield the records that turn the last session into this one, ``mark`` at the end."""
        last, self._last = self._last, session
        for name in list_types():
            before = () if last is None else getattr(last, name)
            yield from _item_changes(name, getattr(session, name), before)
        nothing: dict[str, Any] = dict.fromkeys(list_types(), ())
        yield SESSION, 0, pack(replace(session, **nothing))
        lengths = {name: len(getattr(session, name)) for name in list_types()}
        text, _ = pack(mark)
        yield MARK, 0, (json.dumps({**json.loads(text), "lengths": lengths}), b"")


def _item_changes(name: str, items: Any, before: Any) -> Iterator[Record]:
    for index, item in enumerate(items):
        old = before[index] if index < len(before) else None
        if old is item:
            continue
        yield name, index, pack_fields(item, old) if is_dataclass(item) else pack(item)


@dataclass
class SessionState:
    """A session restored from its log, record by record.

    Attributes:
        mark: The latest mark.
        session: The session at that mark.
        open_session: The last session before the run ended.
    """

    mark: Mark | None = None
    session: Session | None = None
    open_session: Session | None = None
    _open: list[Record] = field(default_factory=list)
    _items: dict[str, dict[int, Any]] = field(default_factory=dict)

    def apply(self, record: Record) -> None:
        """Apply the next ``record``.

        Raises:
            FileError: The record does not fit the earlier ones.
        """
        self._open.append(record)
        if record[0] == MARK:
            records, self._open = self._open, []
            self._close(records)

    def _close(self, records: list[Record]) -> None:
        """Apply all ``records`` since the last mark."""
        # Apply records to the items
        base = self.session
        for kind, index, packed in records[:-1]:
            if kind == SESSION:
                base = unpack(Session, packed)
            elif kind in list_types():
                items = self._items.setdefault(kind, {})
                items[index] = unpack_item(list_types()[kind], items.get(index), packed)
        if base is None:
            raise FileError("no valid session in the file: it begins in the middle")

        # Cut lists to the marked lengths
        text = records[-1][2][0]
        lengths = mark_lengths(text)
        try:
            lists: dict[str, Any] = {
                name: tuple(self._items.get(name, {})[k] for k in range(lengths.get(name, 0)))
                for name in list_types()
            }
        except KeyError as error:
            raise FileError(f"no valid session in the file: item {error} is missing") from None

        # Take the new state
        self.session, self.mark = replace(base, **lists), unpack(Mark, (text, b""))
        if not self.session.stop_reason:
            self.open_session = self.session


def mark_lengths(text: str) -> dict[str, int]:
    """Return how many items of each list a mark counts; ``text`` is its JSON.

    Raises:
        FileError: It is no mark.
    """
    try:
        lengths = parse_json(text)["lengths"]
        if all(type(each) is int for each in lengths.values()):
            return dict(lengths)
    except (ValueError, KeyError, TypeError, AttributeError):
        pass
    raise FileError("no valid mark in the file")


def unpack_item(hint: Any, old: Any, packed: Packed) -> Any:
    """Return the item of type ``hint`` whose changes against ``old`` were packed.

    Raises:
        FileError: The content is not of this type, or only a part of an item without ``old``.
    """
    if not is_dataclass(hint):
        return unpack(hint, packed)
    assert isinstance(hint, type)
    fields = unpack_fields(hint, packed)
    try:
        return hint(**fields) if old is None else replace(old, **fields)
    except TypeError as error:
        raise FileError(f"no valid {hint.__name__} in the file: {error}") from None

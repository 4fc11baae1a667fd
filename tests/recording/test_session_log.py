from dataclasses import replace

import pytest
from same import same

from scan3d_twin.core.errors import FileError
from scan3d_twin.core.types import Pose2
from scan3d_twin.recording.session_log import MARK, Mark, SessionLog, SessionState


def states(session):
    """Return what an observer of ``session`` saw, one after the other."""
    start = replace(session, views=(), plans=(), stop_reason="")
    one = start.with_view(session.views[0])
    look = (1, session.views[0].observation)
    two = replace(one, panoramas=(look,)).with_plan(session.plans[0])
    three = two.with_view(session.views[1])
    aligned = [replace(view, T_world_scan=Pose2(0.1, 0.2, 0.3)) for view in three.views]
    four = replace(three, views=tuple(aligned), misfits=(1,))
    dropped = replace(four, views=four.views[1:], misfits=(0,))
    return [one, two, three, four, dropped, dropped.with_stop_reason("enough")]


def records(history):
    """Return the log's records of each session in ``history``."""
    log = SessionLog()
    return [list(log.changes(each, Mark(float(k)))) for k, each in enumerate(history)]


def test_every_state_comes_back_bit_by_bit(session):
    history, state = states(session), SessionState()
    for k, (expected, changes) in enumerate(zip(history, records(history), strict=True)):
        for record in changes:
            state.apply(record)
        assert same(state.session, expected)
        assert state.mark == Mark(float(k))


def test_an_open_change_does_not_count(session):
    history, state = states(session), SessionState()
    first, second, *_ = records(history)
    for record in [*first, *second[:-1]]:
        state.apply(record)
    assert same(state.session, history[0])


def test_the_log_grows_by_what_is_new(session):
    *_, three, four, _, _ = records(states(session))
    sizes = [sum(len(packed[1]) for _, _, packed in changes) for changes in (three, four)]
    assert sizes[1] < 0.01 * sizes[0]


def test_each_change_ends_with_a_mark(session):
    for changes in records(states(session)):
        assert [kind for kind, _, _ in changes].count(MARK) == 1
        assert changes[-1][0] == MARK


def test_a_log_without_its_beginning_is_broken(session):
    state = SessionState()
    first = records(states(session))[0]
    with pytest.raises(FileError, match="begins in the middle"):
        state.apply(first[-1])

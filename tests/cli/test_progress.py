import io
import math
from dataclasses import replace
from unittest.mock import ANY

import numpy as np
import synthetic
from paper import paper_config
from rich.console import Console

from scan3d_twin.cli.progress import (
    LiveProgress,
    Pace,
    PlainProgress,
    make_bar,
    measure_scanned_share,
    plan_words,
    steps,
    view_words,
)
from scan3d_twin.core.digitize import integrate
from scan3d_twin.core.session import Session
from scan3d_twin.core.types import Plan, Pose2, ScanLine

LINE = ScanLine(0.0, np.full(1, np.nan), np.zeros(1, np.int64))


def scan(tour="front"):
    """Return a session with one view of the middle of three boxes."""
    hint = np.array([[0.65, y] for y in np.linspace(-1.1, 1.1, 23)])
    session = Session(paper_config(tour=tour), 0, hint, np.array([-1.0, 0.0]))
    return integrate(session, synthetic.observe(Pose2(-0.4, 0.0, 0.0)))


def with_plan(session, viewpoint, predicted=0.0042):
    return session.with_plan(Plan(viewpoint, 0.7, predicted, False, (), "it is best"))


def test_a_view_of_the_middle_is_a_part_of_the_front():
    assert 0.3 < measure_scanned_share(scan()) < 0.9


def test_a_view_of_one_side_is_less_than_all_round():
    assert 0.1 < measure_scanned_share(scan("full")) < 0.9


def test_nothing_is_scanned_before_the_first_view():
    session = scan()
    empty = Session(session.config, 0, session.hint, session.front)
    assert measure_scanned_share(empty) == 0.0


def test_a_view_tells_its_index_and_its_share():
    words = view_words(scan())
    assert words.startswith("view 0: ")
    assert "; front outline in top view: " in words
    assert words.endswith("% scanned")
    assert "outline all round in top view: " in view_words(scan("full"))


def test_a_plan_tells_overlap_error_and_reason():
    session = scan()
    words = plan_words(with_plan(session, Pose2()))
    assert words.strip() == "next: 70% overlap, predicted error 4.2 mm (it is best)"
    assert "error unknown" in plan_words(with_plan(session, Pose2(), math.nan))
    assert plan_words(with_plan(session, None)) == "finished: it is best"


def test_plain_progress_is_a_line_per_step(capsys):
    session = with_plan(scan(), Pose2())
    tell(PlainProgress(), session)
    told = capsys.readouterr()
    assert told.err.splitlines() == ["scanning", ANY, plan_words(session)]
    assert told.err.splitlines()[1].startswith(view_words(session) + "; ")
    assert told.out == ""


def test_live_progress_counts_lines_and_keeps_views_and_plans():
    session = with_plan(scan(), Pose2())
    screen = io.StringIO()
    console = Console(file=screen, force_terminal=True, width=120, highlight=False)
    with make_bar(console) as bar:
        task = bar.add_task("begin", total=None, left="")
        progress = LiveProgress(bar, task)
        progress.on_event("scanning")
        progress.on_line(LINE)
        progress.on_line(LINE)
        assert bar.tasks[0].description == "scanning: 2 lines"
        progress.on_view(session)
        assert bar.tasks[0].description == "planning"
        assert (bar.tasks[0].completed, bar.tasks[0].total) == (1, 20)
        assert bar.tasks[0].fields["left"].startswith("1/20")
        progress.on_plan(session)
    assert view_words(session) in screen.getvalue()
    assert plan_words(session) in screen.getvalue()


def tell(progress, session):
    progress.on_event("scanning")
    for _ in range(3):
        progress.on_line(LINE)
    progress.on_view(session)
    progress.on_plan(session)


def test_the_time_left_is_that_of_as_many_views_as_are_allowed():
    times = iter([100.0, 110.0, 114.0])
    pace = Pace(lambda: next(times))
    one = scan()
    clock = f"{one.views[0].observation.image.stamps.max():.0f} s on the robot's clock"
    assert pace.view(one) == f"; 1 view of at most 20, {clock}, 10 s elapsed, at most 190 s left"
    two = replace(one, views=one.views * 2, config=replace(one.config, max_views=2))
    assert pace.view(two) == f"; 2 views of at most 2, {clock}, 14 s elapsed"


def test_steps_tell_how_many_are_done(capsys):
    times = iter([100.0, 110.0, 110.5, 112.0])
    step = steps(PlainProgress(), "replayed view", 3, lambda: next(times))
    step(0)
    step(1)
    step(2)
    assert capsys.readouterr().err.splitlines() == [
        "replayed view 0: 1 of 3 done, 20 s left",
        "replayed view 1: 2 of 3 done, 5 s left",
        "replayed view 2: 3 of 3 done",
    ]


def test_no_time_is_named_that_rounds_to_nothing(capsys):
    times = iter([100.0, 100.3])
    steps(PlainProgress(), "replayed view", 2, lambda: next(times))(0)
    assert capsys.readouterr().err == "replayed view 0: 1 of 2 done\n"
